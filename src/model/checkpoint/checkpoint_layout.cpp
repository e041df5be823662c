#include "model/checkpoint/checkpoint_layout.h"

#include <zlib.h>

#include <algorithm>
#include <limits>

#include "core/check.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kRemedy = "; resume from another checkpoint (--resume auto chooses the newest valid one)";
constexpr std::size_t kMaxDimensions = 8;

CheckpointSection read_section(const Json& json, const std::string& place) {
  CheckpointSection section;
  std::string dtype;
  try {
    json.at("name").get_to(section.name);
    json.at("dtype").get_to(dtype);
    for (const Json& size : json.at("shape").get_ref<const Json::array_t&>()) {
      section.shape.push_back(json_integer<std::int64_t>(size, "a tensor's size", place, 0));
    }
    section.bytes = json_integer<std::uint64_t>(json.at("bytes"), "a tensor's bytes", place);
    section.crc = json_integer<std::uint32_t>(json.at("crc32"), "a tensor's checksum", place);
  } catch (const nlohmann::json::exception&) {
    input_error(place, ": incomplete tensor entry in the header, found ", json_excerpt(json), kRemedy);
  }
  const auto row = std::find_if(kCheckpointDtypes.begin(), kCheckpointDtypes.end(),
                                [&](const CheckpointDtypeRow& known) { return known.name == dtype; });
  if (row == kCheckpointDtypes.end()) {
    input_error(place, ": tensor ", section.name, ": unknown type ", dtype, kRemedy);
  }
  section.dtype = static_cast<CheckpointDtype>(row - kCheckpointDtypes.begin());
  std::uint64_t count = 1, most = 1;  // `most` ignores empty dimensions, as strides do
  bool fits = section.shape.size() <= kMaxDimensions;
  for (const std::int64_t size : section.shape) {
    constexpr std::uint64_t kMaxCount = std::numeric_limits<std::int64_t>::max() / 8;
    const auto factor = static_cast<std::uint64_t>(std::max<std::int64_t>(size, 1));
    fits = fits && most <= kMaxCount / factor;
    most *= factor;
    count *= static_cast<std::uint64_t>(size);
  }
  if (!fits) input_error(place, ": tensor ", section.name, ": impossible shape", kRemedy);
  if (count * row->bytes != section.bytes) {
    input_error(place, ": tensor ", section.name, ": expected ", count, " x ", row->bytes, " bytes, found ",
                section.bytes, kRemedy);
  }
  return section;
}

}  // namespace

std::uint32_t add_crc(std::uint32_t crc, const void* data, std::uint64_t bytes) {
  return static_cast<std::uint32_t>(::crc32_z(crc, static_cast<const Bytef*>(data), bytes));
}

CheckpointLayout read_checkpoint_layout(FileReader& file) {
  const std::string place = file.name();
  std::array<char, kCheckpointMagic.size()> magic{};
  file.begin_record("part", 0, 2);
  if (file.remaining() >= magic.size()) file.read_bytes(magic.data(), magic.size());
  if (magic != kCheckpointMagic) {
    input_error(place, ": not a b3dgs checkpoint (expected it to begin with ",
                std::string(kCheckpointMagic.data(), kCheckpointMagic.size()),
                "); checkpoints are MODEL/checkpoints/iteration_N.b3dgs");
  }
  const auto version = file.read<std::uint32_t>();
  if (version != kCheckpointVersion) {
    input_error(place, ": expected checkpoint format version ", kCheckpointVersion, ", found version ", version,
                "; resume with the version of b3dgs that wrote it");
  }
  const auto crc = file.read<std::uint32_t>();
  const auto bytes = file.read<std::uint64_t>();
  if (bytes > file.remaining()) {
    input_error(place, ": truncated: expected a header of ", bytes, " bytes, found ", file.remaining(), kRemedy);
  }
  std::string text(bytes, '\0');
  file.read_bytes(text.data(), text.size());
  if (add_crc(0, text.data(), text.size()) != crc)
    input_error(place, ": wrong checksum of the header: the file is damaged", kRemedy);

  CheckpointLayout layout;
  layout.header = parse_json(text);
  if (!layout.header.is_object() || !layout.header.contains("tensors") || !layout.header["tensors"].is_array()) {
    input_error(place, ": unexpected checkpoint header (expected a list of tensors)", kRemedy);
  }
  std::uint64_t expected = 0;
  for (const Json& entry : layout.header["tensors"]) {
    layout.sections.push_back(read_section(entry, place));
    const std::uint64_t own = layout.sections.back().bytes;
    if (own > file.remaining() || expected > file.remaining() - own) {
      input_error(place, ": truncated: expected at least ", expected + own,
                  " bytes after the header, for the tensors up to ", layout.sections.back().name, ", found ",
                  file.remaining(), kRemedy);
    }
    expected += own;
  }
  if (expected != file.remaining()) {
    input_error(place, ": expected ", expected, " bytes after the header, found ", file.remaining(), kRemedy);
  }
  return layout;
}

void check_crc(const FileReader& file, const CheckpointSection& section, std::uint32_t crc) {
  if (crc != section.crc) {
    input_error(file.name(), ": wrong checksum of tensor ", section.name, ": the file is damaged", kRemedy);
  }
}

void verify_sections(FileReader& file, const CheckpointLayout& layout) {
  std::vector<char> buffer;
  for (const CheckpointSection& section : layout.sections) {
    std::uint32_t crc = 0;
    buffer.resize(std::min<std::uint64_t>(section.bytes, std::uint64_t{1} << 20));
    for (std::uint64_t left = section.bytes; left > 0;) {
      const std::uint64_t part = std::min<std::uint64_t>(left, buffer.size());
      file.read_bytes(buffer.data(), part);
      crc = add_crc(crc, buffer.data(), part);
      left -= part;
    }
    check_crc(file, section, crc);
  }
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
