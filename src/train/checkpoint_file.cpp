#include "train/checkpoint_file.h"

#include <zlib.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>

#include "check.h"
#include "scene/file_reader.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::array<char, 8> kMagic{'B', '3', 'D', 'G', 'S', 'C', 'K', 'P'};
constexpr std::uint32_t kVersion = 1;
constexpr std::size_t kTensorOffset = kMagic.size() + 2 * sizeof(std::uint32_t) + sizeof(std::uint64_t);  // + header
constexpr const char* kRemedy = "; resume from another checkpoint (--resume auto takes the newest valid one)";

struct DtypeName {
  const char* name;
  torch::ScalarType type;
  std::uint64_t bytes;
};
constexpr std::array<DtypeName, 3> kDtypes{
    {{"float32", torch::kFloat32, 4}, {"int32", torch::kInt32, 4}, {"int64", torch::kInt64, 8}}};

std::uint32_t add_crc(std::uint32_t crc, const void* data, std::uint64_t bytes) {
  return static_cast<std::uint32_t>(::crc32_z(crc, static_cast<const Bytef*>(data), bytes));
}

/// What the header says of one tensor.
struct Section {
  std::string name;
  DtypeName dtype{};
  std::vector<std::int64_t> shape;
  std::uint64_t bytes = 0;
  std::uint32_t crc = 0;
};

Section read_section(const Json& json, const std::string& place) {
  Section section;
  std::string dtype;
  try {
    json.at("name").get_to(section.name);
    json.at("dtype").get_to(dtype);
    json.at("shape").get_to(section.shape);
    json.at("bytes").get_to(section.bytes);
    json.at("crc32").get_to(section.crc);
  } catch (const nlohmann::json::exception&) {
    input_error(place, ": a tensor's entry in the header is not complete, found ", json.dump(), kRemedy);
  }
  const auto row = std::find_if(kDtypes.begin(), kDtypes.end(), [&](const DtypeName& d) { return d.name == dtype; });
  if (row == kDtypes.end()) input_error(place, ": tensor ", section.name, " has the unknown type ", dtype, kRemedy);
  section.dtype = *row;
  std::uint64_t count = 1;
  for (const std::int64_t size : section.shape) {
    const bool fits = size >= 0 && (size == 0 || count <= std::numeric_limits<std::int64_t>::max() / 8 /
                                                              static_cast<std::uint64_t>(size));
    if (!fits) input_error(place, ": tensor ", section.name, " has an impossible shape", kRemedy);
    count *= static_cast<std::uint64_t>(size);
  }
  if (count * section.dtype.bytes != section.bytes) {
    input_error(place, ": tensor ", section.name, " of ", count, " x ", section.dtype.bytes, " bytes is said to have ",
                section.bytes, kRemedy);
  }
  return section;
}

struct Header {
  Json json;
  std::vector<Section> sections;
};

/// Leaves the reader at the first tensor; what follows has exactly the length that the header says.
Header read_header(FileReader& file) {
  const std::string place = file.name();
  std::array<char, kMagic.size()> magic{};
  file.begin_record("part", 0, 2);
  if (file.remaining() < kMagic.size()) input_error(place, ": is no checkpoint: it has ", file.remaining(), " bytes");
  file.read_bytes(magic.data(), magic.size());
  if (magic != kMagic)
    input_error(place, ": is no checkpoint: it does not begin with ", std::string(kMagic.data(), kMagic.size()));
  const auto version = file.read<std::uint32_t>();
  if (version != kVersion) {
    input_error(place, ": checkpoint layout ", version, ", this program reads layout ", kVersion,
                "; resume with the version of b3dgs that wrote it");
  }
  const auto crc = file.read<std::uint32_t>();
  const auto bytes = file.read<std::uint64_t>();
  if (bytes > file.remaining()) {
    input_error(place, ": is truncated: the header has ", bytes, " bytes, the file ", file.remaining(), " more",
                kRemedy);
  }
  std::string text(bytes, '\0');
  file.read_bytes(text.data(), text.size());
  if (add_crc(0, text.data(), text.size()) != crc) input_error(place, ": the header's checksum is wrong", kRemedy);

  Header header;
  header.json = Json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!header.json.is_object() || !header.json.contains("tensors") || !header.json["tensors"].is_array()) {
    input_error(place, ": the header is not what this program writes", kRemedy);
  }
  std::uint64_t expected = 0;
  for (const Json& entry : header.json["tensors"]) {
    header.sections.push_back(read_section(entry, place));
    const std::uint64_t own = header.sections.back().bytes;
    if (own > file.remaining() || expected > file.remaining() - own) {
      input_error(place, ": is truncated: tensor ", header.sections.back().name, " needs ", expected + own,
                  " bytes behind the header, found ", file.remaining(), kRemedy);
    }
    expected += own;
  }
  if (expected != file.remaining()) {
    input_error(place, ": ", file.remaining(), " bytes follow the header, expected ", expected, kRemedy);
  }
  return header;
}

void check_crc(const FileReader& file, const Section& section, std::uint32_t crc) {
  if (crc != section.crc) {
    input_error(file.name(), ": the checksum of tensor ", section.name, " is wrong: the file is damaged", kRemedy);
  }
}

}  // namespace

CheckpointFileWriter::CheckpointFileWriter(const std::filesystem::path& path, Json header,
                                           const std::vector<TensorEntry>& tensors)
    : header_(std::move(header)), file_(path) {
  // As if all checksums were of the greatest length: the header that is written in the end is no longer than this one.
  constexpr std::uint32_t kLongest = std::numeric_limits<std::uint32_t>::max();
  Json& entries = header_["tensors"] = Json::array();
  for (const TensorEntry& tensor : tensors) {
    const auto dtype =
        std::find_if(kDtypes.begin(), kDtypes.end(), [&](const DtypeName& d) { return d.type == tensor.type; });
    B3DGS_CHECK(dtype != kDtypes.end(), tensor.name, " has a type that checkpoints do not hold");
    std::uint64_t bytes = dtype->bytes;
    for (const std::int64_t size : tensor.shape) bytes *= static_cast<std::uint64_t>(size);
    entries.push_back({{"name", tensor.name},
                       {"dtype", dtype->name},
                       {"shape", tensor.shape},
                       {"bytes", bytes},
                       {"crc32", kLongest}});
  }
  header_bytes_ = header_text().size();
  file_.write(std::string(kTensorOffset + header_bytes_, ' '));
  for (Json& entry : entries) entry["crc32"] = 0;  // of no bytes
  if (!entries.empty()) left_ = entries[0]["bytes"];
}

std::string CheckpointFileWriter::header_text() const {
  return header_.dump(-1, ' ', false, Json::error_handler_t::replace);
}

void CheckpointFileWriter::append(const void* data, std::uint64_t bytes) {
  file_.write(data, bytes);
  Json& entries = header_["tensors"];
  const char* from = static_cast<const char*>(data);
  while (bytes > 0) {
    while (left_ == 0 && ++tensor_ < entries.size()) left_ = entries[tensor_]["bytes"];
    B3DGS_CHECK(left_ > 0, "a checkpoint is given more bytes than its tensors have");
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
  B3DGS_CHECK(left_ == 0, "a checkpoint lacks ", left_, " bytes of its tensors");
  std::string text = header_text();
  text.resize(header_bytes_, ' ');
  const std::uint32_t version = kVersion, crc = add_crc(0, text.data(), text.size());
  const std::uint64_t bytes = text.size();
  std::string start(kMagic.data(), kMagic.size());
  start.append(reinterpret_cast<const char*>(&version), sizeof version);
  start.append(reinterpret_cast<const char*>(&crc), sizeof crc);
  start.append(reinterpret_cast<const char*>(&bytes), sizeof bytes);
  start += text;
  file_.rewrite(0, start.data(), start.size());
}

void write_checkpoint_file(const std::filesystem::path& path, const CheckpointFile& content) {
  std::vector<TensorEntry> entries;
  for (const auto& [name, tensor] : content.tensors) {
    entries.push_back({name, tensor.scalar_type(), tensor.sizes().vec()});
  }
  CheckpointFileWriter file(path, content.header, entries);
  for (const auto& [name, tensor] : content.tensors) {
    const torch::Tensor host = tensor.to(torch::kCPU).contiguous();
    file.append(host.data_ptr(), host.nbytes());
  }
  file.finish();
  file.commit();
}

CheckpointFile read_checkpoint_file(const std::filesystem::path& path) {
  FileReader file(path);
  Header header = read_header(file);
  CheckpointFile content;
  for (const Section& section : header.sections) {
    torch::Tensor tensor = torch::empty(section.shape, section.dtype.type);
    file.read_bytes(tensor.data_ptr(), section.bytes);
    check_crc(file, section, add_crc(0, tensor.data_ptr(), section.bytes));
    content.tensors.emplace_back(section.name, std::move(tensor));
  }
  header.json.erase("tensors");
  content.header = std::move(header.json);
  return content;
}

Json read_checkpoint_header(const std::filesystem::path& path) {
  FileReader file(path);
  return read_header(file).json;
}

void verify_checkpoint_file(const std::filesystem::path& path) {
  FileReader file(path);
  const Header header = read_header(file);
  std::vector<char> buffer(std::size_t{1} << 20);
  for (const Section& section : header.sections) {
    std::uint32_t crc = 0;
    for (std::uint64_t left = section.bytes; left > 0;) {
      const std::uint64_t part = std::min<std::uint64_t>(left, buffer.size());
      file.read_bytes(buffer.data(), part);
      crc = add_crc(crc, buffer.data(), part);
      left -= part;
    }
    check_crc(file, section, crc);
  }
}

}  // namespace b3dgs
