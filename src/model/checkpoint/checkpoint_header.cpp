#include "model/checkpoint/checkpoint_header.h"

#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>

#include "config/batch_steps.h"
#include "config/option_layers.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::int64_t kMaxGaussians = std::numeric_limits<std::int32_t>::max() - 1;  // limit of 32-bit indices

double finite_number(const Json& json, const char* what, const std::string& place) {
  if (!json.is_number() || !std::isfinite(json.get<double>())) {
    input_error(place, ": ", what, " must be a finite number, found ", json_excerpt(json));
  }
  return json.get<double>();
}

const Json& object_at(const Json& json, const char* key, const std::string& place) {
  const Json& value = json.at(key);
  if (!value.is_object()) input_error(place, ": ", key, " must be an object, found ", json_excerpt(value));
  return value;
}

ViewOrder parse_view_order(const Json& json, std::size_t n_views, const std::string& place) {
  ViewOrder order;
  order.n_refills = json_integer<std::uint32_t>(json.at("n_refills"), "view_order.n_refills", place);
  std::vector<bool> is_there(n_views);
  for (const Json& entry : json.at("remaining").get_ref<const Json::array_t&>()) {
    const auto view = json_integer<std::int32_t>(entry, "a view of view_order.remaining", place, 0);
    const auto index = static_cast<std::size_t>(view);
    if (index >= n_views || is_there[index]) {
      input_error(place, ": expected views below ", n_views, " in view_order.remaining, each at most once, found view ",
                  view);
    }
    is_there[index] = true;
    order.remaining.push_back(view);
  }
  return order;
}

ViewRatios::Largest parse_ratios(const Json& json, const char* what, const std::string& place) {
  const auto value = [&](const char* key) {
    const double ratio = finite_number(json.at(key), what, place);
    if (ratio < 0) input_error(place, ": ", what, ": expected at least 0, found ", ratio);
    return ratio;
  };
  return {value("splats"), value("pairs")};
}

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

Json ratios_to_json(const ViewRatios& ratios) {
  const auto json = [](const ViewRatios::Largest& of) { return Json{{"splats", of.splats}, {"pairs", of.pairs}}; };
  return {{"before", json(ratios.before())}, {"now", json(ratios.now())}};
}

CheckpointHeader parse_checkpoint_header(const Json& json, const std::string& place) {
  CheckpointHeader header;
  try {
    config_from_json(header.config, json.at("config"), place);
    header.iteration = json_integer<int>(json.at("iteration"), "iteration", place, 0);
    header.n_gaussians = json_integer<std::int64_t>(json.at("n_gaussians"), "n_gaussians", place, 1, kMaxGaussians);
    header.sh_degree = json_integer<int>(json.at("sh_degree"), "sh_degree", place, 0, header.config.sh_degree);
    header.adam_steps = json_integer<std::int64_t>(json.at("adam_steps"), "adam_steps", place, 0, header.iteration);
    header.loss_average = finite_number(json.at("loss_average"), "loss_average", place);
    const auto take_integer = [&](const char* key, auto& value, auto min, auto max) {
      using Integer = std::decay_t<decltype(value)>;
      value = json_integer<Integer>(json.at(key), key, place, Integer{min}, Integer{max});
    };
    constexpr std::int64_t kAny = std::numeric_limits<std::int64_t>::max();
    header.elapsed_s = finite_number(json.at("elapsed_s"), "elapsed_s", place);
    if (header.elapsed_s < 0) input_error(place, ": elapsed_s must be at least 0, found ", header.elapsed_s);
    header.training_id = json.at("training_id").get<std::string>();
    take_integer("step_iterations", header.step_iterations, 1, std::clamp(header.iteration, 1, kMaxBatch));
    take_integer("n_density_pending", header.n_density_pending, 0, header.step_iterations);
    take_integer("n_removed", header.n_removed, 0, kAny);
    take_integer("count_cap", header.count_cap, 0, kAny);
    if (json.contains("appearance_steps")) {
      take_integer("appearance_steps", header.appearance_steps, 0, header.iteration);
    }
    if (const auto it = json.find("appearance_last_steps"); it != json.end()) {
      if (!it->is_array()) input_error(place, ": appearance_last_steps must be a list, found ", json_excerpt(*it));
      for (const Json& step : *it) {
        header.appearance_last_steps.push_back(
            json_integer<std::int64_t>(step, "a value of appearance_last_steps", place, 0, header.appearance_steps));
      }
    }
    header.kernel_selection = object_at(json, "kernel_selection", place);
    header.scene = object_at(json, "scene", place);
    finite_number(header.scene.at("extent"), "scene.extent", place);
    const std::size_t n_views = header.scene.at("train_views").get_ref<const Json::array_t&>().size();
    header.view_order = parse_view_order(json.at("view_order"), n_views, place);
    if (const auto it = json.find("view_ratios"); it != json.end()) {
      header.view_ratios = {parse_ratios(it->at("before"), "view_ratios.before", place),
                            parse_ratios(it->at("now"), "view_ratios.now", place)};
    }
  } catch (const nlohmann::json::exception& error) {
    input_error(place, ": unexpected checkpoint header: ", error.what());
  }
  return header;
}

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
  if (add_crc(0, text.data(), text.size()) != crc) {
    input_error(place, ": wrong checksum of the header: the file is damaged", kRemedy);
  }

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
