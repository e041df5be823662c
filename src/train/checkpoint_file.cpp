#include "train/checkpoint_file.h"

#include <algorithm>
#include <array>

#include "check.h"
#include "scene/atomic_file.h"
#include "train/checkpoint_layout.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

// In the order of CheckpointDtype.
constexpr std::array<torch::ScalarType, kCheckpointDtypes.size()> kTorchTypes{torch::kFloat32, torch::kInt32,
                                                                              torch::kInt64};

}  // namespace

void write_checkpoint_file(const std::filesystem::path& path, const CheckpointFile& content) {
  std::vector<torch::Tensor> tensors;
  Json header = content.header;
  Json& entries = header["tensors"] = Json::array();
  for (const auto& [name, tensor] : content.tensors) {
    const torch::Tensor host = tensor.to(torch::kCPU).contiguous();
    const auto type = std::find(kTorchTypes.begin(), kTorchTypes.end(), host.scalar_type());
    B3DGS_CHECK(type != kTorchTypes.end(), name, " has a type that checkpoints do not hold");
    entries.push_back({{"name", name},
                       {"dtype", kCheckpointDtypes[static_cast<std::size_t>(type - kTorchTypes.begin())].name},
                       {"shape", host.sizes().vec()},
                       {"bytes", host.nbytes()},
                       {"crc32", add_crc(0, host.data_ptr(), host.nbytes())}});
    tensors.push_back(host);
  }
  const std::string text = header.dump(-1, ' ', false, Json::error_handler_t::replace);
  const std::uint32_t version = kCheckpointVersion, crc = add_crc(0, text.data(), text.size());
  const std::uint64_t bytes = text.size();

  AtomicFile file(path);
  file.write(kCheckpointMagic.data(), kCheckpointMagic.size());
  file.write(&version, sizeof version);
  file.write(&crc, sizeof crc);
  file.write(&bytes, sizeof bytes);
  file.write(text);
  for (const torch::Tensor& tensor : tensors) file.write(tensor.data_ptr(), tensor.nbytes());
  file.commit();
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

Json read_checkpoint_header(const std::filesystem::path& path) {
  FileReader file(path);
  return read_checkpoint_layout(file).header;
}

void verify_checkpoint_file(const std::filesystem::path& path) {
  FileReader file(path);
  verify_sections(file, read_checkpoint_layout(file));
}

}  // namespace b3dgs
