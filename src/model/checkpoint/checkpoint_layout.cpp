#include "model/checkpoint/checkpoint_layout.h"

#include <zlib.h>

#include <algorithm>
#include <limits>

#include "core/check.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kRemedy = "; resume from another checkpoint (--resume auto takes the newest valid one)";
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
    input_error(place, ": a tensor's entry in the header is not complete, found ", json_excerpt(json), kRemedy);
  }
  const auto row = std::find_if(kCheckpointDtypes.begin(), kCheckpointDtypes.end(),
                                [&](const CheckpointDtypeRow& known) { return known.name == dtype; });
  if (row == kCheckpointDtypes.end()) {
    input_error(place, ": tensor ", section.name, " has the unknown type ", dtype, kRemedy);
  }
  section.dtype = static_cast<CheckpointDtype>(row - kCheckpointDtypes.begin());
  std::uint64_t count = 1, most = 1;  // `most` with empty dimensions left out, as strides go by it
  bool fits = section.shape.size() <= kMaxDimensions;
  for (const std::int64_t size : section.shape) {
    constexpr std::uint64_t kMaxCount = std::numeric_limits<std::int64_t>::max() / 8;
    const auto factor = static_cast<std::uint64_t>(std::max<std::int64_t>(size, 1));
    fits = fits && most <= kMaxCount / factor;
    most *= factor;
    count *= static_cast<std::uint64_t>(size);
  }
  if (!fits) input_error(place, ": tensor ", section.name, " has an impossible shape", kRemedy);
  if (count * row->bytes != section.bytes) {
    input_error(place, ": tensor ", section.name, " of ", count, " x ", row->bytes, " bytes is said to have ",
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
  if (file.remaining() < kCheckpointMagic.size())
    input_error(place, ": is no checkpoint: it has ", file.remaining(), " bytes");
  file.read_bytes(magic.data(), magic.size());
  if (magic != kCheckpointMagic)
    input_error(place, ": is no checkpoint: it does not begin with ",
                std::string(kCheckpointMagic.data(), kCheckpointMagic.size()));
  const auto version = file.read<std::uint32_t>();
  if (version != kCheckpointVersion) {
    input_error(place, ": checkpoint layout ", version, ", this program reads layout ", kCheckpointVersion,
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

  CheckpointLayout layout;
  layout.header = parse_json(text);
  if (!layout.header.is_object() || !layout.header.contains("tensors") || !layout.header["tensors"].is_array()) {
    input_error(place, ": the header is not what this program writes", kRemedy);
  }
  std::uint64_t expected = 0;
  for (const Json& entry : layout.header["tensors"]) {
    layout.sections.push_back(read_section(entry, place));
    const std::uint64_t own = layout.sections.back().bytes;
    if (own > file.remaining() || expected > file.remaining() - own) {
      input_error(place, ": is truncated: tensor ", layout.sections.back().name, " needs ", expected + own,
                  " bytes behind the header, found ", file.remaining(), kRemedy);
    }
    expected += own;
  }
  if (expected != file.remaining()) {
    input_error(place, ": ", file.remaining(), " bytes follow the header, expected ", expected, kRemedy);
  }
  return layout;
}

void check_crc(const FileReader& file, const CheckpointSection& section, std::uint32_t crc) {
  if (crc != section.crc) {
    input_error(file.name(), ": the checksum of tensor ", section.name, " is wrong: the file is damaged", kRemedy);
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

}  // namespace b3dgs
