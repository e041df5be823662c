#include "train/checkpoint/checkpoint.h"

#include <algorithm>
#include <array>
#include <limits>

#include "core/check.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

// In the order of CheckpointDtype.
constexpr std::array<torch::ScalarType, kCheckpointDtypes.size()> kTorchTypes{torch::kFloat32, torch::kInt32,
                                                                              torch::kInt64};

constexpr std::size_t kTensorOffset =  // bytes before the header
    kCheckpointMagic.size() + 2 * sizeof(std::uint32_t) + sizeof(std::uint64_t);

}  // namespace

CheckpointFileWriter::CheckpointFileWriter(const std::filesystem::path& path, Json header,
                                           const std::vector<TensorEntry>& tensors)
    : header_(std::move(header)), file_(path) {
  // Reserves space for checksums with the maximum number of digits, so that the final header is not longer than this
  // one.
  constexpr std::uint32_t kLongest = std::numeric_limits<std::uint32_t>::max();
  Json& entries = header_["tensors"] = Json::array();
  for (const TensorEntry& tensor : tensors) {
    const auto type = std::find(kTorchTypes.begin(), kTorchTypes.end(), tensor.type);
    B3DGS_CHECK(type != kTorchTypes.end(), tensor.name, ": its type cannot be stored in a checkpoint");
    const CheckpointDtypeRow& dtype = kCheckpointDtypes[static_cast<std::size_t>(type - kTorchTypes.begin())];
    std::uint64_t bytes = dtype.bytes;
    for (const std::int64_t size : tensor.shape) bytes *= static_cast<std::uint64_t>(size);
    entries.push_back(
        {{"name", tensor.name}, {"dtype", dtype.name}, {"shape", tensor.shape}, {"bytes", bytes}, {"crc32", kLongest}});
  }
  header_bytes_ = header_text().size();
  file_.write(std::string(kTensorOffset + header_bytes_, ' '));
  for (Json& entry : entries) entry["crc32"] = 0;  // checksum of zero bytes
  if (!entries.empty()) left_ = entries[0]["bytes"];
}

std::string CheckpointFileWriter::header_text() const {
  return dump_json(header_);
}

void CheckpointFileWriter::append(const void* data, std::uint64_t bytes) {
  file_.write(data, bytes);
  Json& entries = header_["tensors"];
  const char* from = static_cast<const char*>(data);
  while (bytes > 0) {
    while (left_ == 0 && ++tensor_ < entries.size()) left_ = entries[tensor_]["bytes"];
    B3DGS_CHECK(left_ > 0, "append(): more bytes than the tensors have");
    const std::uint64_t own = std::min(bytes, left_);
    Json& crc = entries[tensor_]["crc32"];
    crc = add_crc(crc.get<std::uint32_t>(), from, own);
    from += own;
    bytes -= own;
    left_ -= own;
  }
}

void CheckpointFileWriter::finish() {
  const Json& entries = header_["tensors"];
  while (left_ == 0 && ++tensor_ < entries.size()) left_ = entries[tensor_]["bytes"];
  B3DGS_CHECK(left_ == 0, "finish(): ", left_, " bytes of a tensor are missing");
  std::string text = header_text();
  text.resize(header_bytes_, ' ');
  const std::uint32_t version = kCheckpointVersion, crc = add_crc(0, text.data(), text.size());
  const std::uint64_t bytes = text.size();
  std::string start(kCheckpointMagic.data(), kCheckpointMagic.size());
  start.append(reinterpret_cast<const char*>(&version), sizeof version);
  start.append(reinterpret_cast<const char*>(&crc), sizeof crc);
  start.append(reinterpret_cast<const char*>(&bytes), sizeof bytes);
  start += text;
  file_.rewrite(0, start.data(), start.size());
}

CheckpointFile read_checkpoint_file(const std::filesystem::path& path) {
  FileReader file(path);
  CheckpointLayout layout = read_checkpoint_layout(file);
  CheckpointFile content;
  for (const CheckpointSection& section : layout.sections) {
    torch::Tensor tensor = torch::empty(section.shape, kTorchTypes[static_cast<std::size_t>(section.dtype)]);
    file.read_bytes(tensor.data_ptr(), section.bytes);
    check_crc(file, section, add_crc(0, tensor.data_ptr(), section.bytes));
    content.tensors.emplace_back(section.name, std::move(tensor));
  }
  layout.header.erase("tensors");
  content.header = std::move(layout.header);
  return content;
}

}  // namespace b3dgs
