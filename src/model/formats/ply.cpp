// The properties of Gaussians in PLY files.
#include "model/formats/splat_formats.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <string>
#include <string_view>

#include "core/check.h"
#include "core/files/ply_reader.h"
#include "core/text.h"
#include "raster/math/sh.h"

namespace b3dgs {
namespace {

constexpr std::int64_t kRowsPerBlock = 4096;
// Tells viewers to apply the 2D filter of Mip-Splatting.
constexpr const char* kAntialiasedComment = "SplatRenderMode: mip";
constexpr const char* kUsualComment = "SplatRenderMode: default";
// Replace f_dc_0 to f_dc_2 in files whose Gaussians look the same from all sides.
constexpr std::array<const char*, 3> kColors{"red", "green", "blue"};
// Mip-Splatting's standard deviation of the 3D filter in world units. Its create_fused_ply.py includes it in scales and
// opacities.
constexpr const char* kFilter = "filter_3D";

#if defined(__BYTE_ORDER__)
static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "values are written in memory order");
#endif

// Opacities of 8 bits are often exactly 0 or 1, whose logits are infinite. With this limit, opacity is 1 - 3e-7.
constexpr double kLargestLogit = 15;
// Flat Gaussians of other programs have a scale of 0, whose logarithm is infinite. With this limit, it is 2e-9 world
// units.
constexpr double kLargestLogScale = 20;

/// A property of the file, and the position of its values in a SplatCloud.
struct Property {
  std::string name;
  std::vector<float> SplatCloud::*values;  // [N, width]
  std::size_t width, column;
};

// In the order of the file. Normals, after x, y and z, are not included, because they are written as 0 and not read.
std::vector<Property> properties_of(int sh_degree) {
  std::vector<Property> properties{
      {"x", &SplatCloud::means, 3, 0}, {"y", &SplatCloud::means, 3, 1}, {"z", &SplatCloud::means, 3, 2}};
  const auto add = [&](const char* prefix, std::vector<float> SplatCloud::*values, std::size_t width) {
    for (std::size_t i = 0; i < width; ++i) properties.push_back({prefix + std::to_string(i), values, width, i});
  };
  add("f_dc_", &SplatCloud::sh0, 3);
  const std::size_t n_rest = sh_rest_count(sh_degree), n_coefficients = n_rest / 3;
  for (std::size_t i = 0; i < n_rest; ++i) {  // [channel, coefficient] in the file
    const std::size_t column = i % n_coefficients * 3 + i / n_coefficients;
    properties.push_back({"f_rest_" + std::to_string(i), &SplatCloud::shN, n_rest, column});
  }
  properties.push_back({"opacity", &SplatCloud::logit_opacities, 1, 0});
  add("scale_", &SplatCloud::log_scales, 3);
  add("rot_", &SplatCloud::quats, 4);
  return properties;
}

/// @throws InputError for formats of other programs that resemble a PLY of Gaussians
int sh_degree_of(const PlyReader& reader) {
  const PlyElement& vertices = reader.vertices();
  const auto n_rest = static_cast<std::size_t>(
      std::count_if(vertices.properties.begin(), vertices.properties.end(),
                    [](const PlyProperty& property) { return property.name.rfind("f_rest_", 0) == 0; }));
  for (int degree = 0; degree <= kMaxShDegree; ++degree) {
    if (sh_rest_count(degree) == n_rest) return degree;
  }
  input_error(reader.name(), ": expected 0, 9, 24 or 45 properties f_rest_* (SH degree 0 to 3), found ", n_rest);
}

/// Returns whether the vertices are Gaussians, even if properties are missing. Points have none of these.
bool holds_gaussians(const PlyElement& vertices) {
  return vertices.find("f_dc_0") || vertices.find("scale_0") || vertices.find("rot_0");
}

/// Reads the render mode from the comments. Adds a note if the renderer does not support it.
bool is_antialiased(const PlyReader& reader, std::vector<std::string>& notes) {
  bool is_mip = false;
  for (const std::string& comment : reader.comments()) {
    is_mip = is_mip || comment == kAntialiasedComment;
    if (comment.rfind("SplatRenderMode:", 0) != 0 || comment == kAntialiasedComment || comment == kUsualComment) {
      continue;
    }
    notes.push_back(detail::concat(reader.name(), ": ignored \"", comment, "\" (expected ", kAntialiasedComment, " or ",
                                   kUsualComment, "); the Gaussians may look different elsewhere"));
  }
  return is_mip;
}

/// Adds a note if some properties are not read. Programs with other kinds of Gaussians add properties that change the
/// meaning of the standard ones.
void note_others(const PlyReader& reader, const std::vector<std::string>& read, std::vector<std::string>& notes) {
  constexpr std::array<std::string_view, 7> kMeaningless{"nx", "ny", "nz", "red", "green", "blue", "alpha"};
  constexpr std::size_t kMostNames = 8;
  std::vector<std::string> others;
  for (const PlyProperty& property : reader.vertices().properties) {
    const bool is_read = std::find(read.begin(), read.end(), property.name) != read.end();
    const bool is_known = std::find(kMeaningless.begin(), kMeaningless.end(), property.name) != kMeaningless.end();
    if (!is_read && !is_known) others.push_back(property.name);
  }
  if (others.empty()) return;
  const std::size_t n_more = others.size() - std::min(others.size(), kMostNames);
  others.resize(others.size() - n_more);
  notes.push_back(detail::concat(reader.name(), ": ignored properties of another program: ", list_text(others),
                                 n_more > 0 ? detail::concat(" and ", n_more, " more") : "",
                                 "; the Gaussians may look different there"));
}

/// Returns the frame of the world, unless it is too far from the Gaussians for single precision.
CoordinateFrame frame_of_file(const std::vector<double>& positions) {
  CoordinateFrame around = choose_frame({}, positions);
  double largest = 0;
  for (const double value : positions) largest = std::max(largest, std::abs(value));
  around.unit = std::max(around.unit, 1e-30 * largest);  // outliers stay finite
  return around.is_far() ? around : CoordinateFrame{};
}

}  // namespace

SplatPlyWriter::SplatPlyWriter(const std::filesystem::path& path, std::int64_t count, int sh_degree, bool antialiased,
                               const CoordinateFrame& frame)
    : count_(count), sh_degree_(sh_degree), frame_(frame), file_(path) {
  B3DGS_CHECK(sh_degree >= 0 && sh_degree <= kMaxShDegree, "SH degree ", sh_degree);
  std::vector<std::pair<std::string, const char*>> properties;
  for (const Property& property : properties_of(sh_degree)) {
    const bool is_mean = property.values == &SplatCloud::means;
    properties.emplace_back(property.name, is_mean && frame.is_far() ? "double" : "float");
    if (property.name != "z") continue;
    for (const char* name : {"nx", "ny", "nz"}) properties.emplace_back(name, "float");
  }
  file_.write(ply_header(count, properties, antialiased ? kAntialiasedComment : ""));
}

void SplatPlyWriter::append(const SplatCloud& rows) {
  constexpr std::size_t kMeans = 3, kNormals = 3;
  const std::int64_t n = rows.size();
  B3DGS_CHECK(rows.sh_degree == sh_degree_ && n_written_ + n <= count_, "expected ", count_, " rows of SH degree ",
              sh_degree_, ", found ", n_written_ + n, " of SH degree ", rows.sh_degree);
  const std::vector<Property> properties = properties_of(sh_degree_);
  for (const Property& property : properties) {
    const std::size_t found = (rows.*property.values).size();
    B3DGS_CHECK(found == property.width * static_cast<std::size_t>(n), n, " Gaussians have ", found, " values of ",
                property.width, " properties");
  }
  const bool is_far = frame_.is_far();
  const std::size_t mean_bytes = kMeans * (is_far ? sizeof(double) : sizeof(float));
  const std::size_t row_bytes = mean_bytes + (kNormals + properties.size() - kMeans) * sizeof(float);
  const double log_unit = std::log(frame_.unit);
  std::vector<char> block;
  for (std::int64_t begin = 0; begin < n; begin += kRowsPerBlock) {
    const std::int64_t end = std::min(n, begin + kRowsPerBlock);
    block.assign(static_cast<std::size_t>(end - begin) * row_bytes, 0);  // normals stay 0
    std::size_t offset = 0;
    for (const Property& property : properties) {
      const bool is_mean = property.values == &SplatCloud::means, is_scale = property.values == &SplatCloud::log_scales;
      const float* from =
          (rows.*property.values).data() + static_cast<std::size_t>(begin) * property.width + property.column;
      char* to = block.data() + offset;
      const auto put = [&](auto value) { std::memcpy(to, &value, sizeof value); };
      for (std::int64_t row = begin; row < end; ++row, from += property.width, to += row_bytes) {
        if (is_mean) {
          const double world = frame_.origin[property.column] + frame_.unit * *from;
          is_far ? put(world) : put(static_cast<float>(world));
        } else {
          put(is_scale ? static_cast<float>(*from + log_unit) : *from);
        }
      }
      offset += is_mean && is_far ? sizeof(double) : sizeof(float);
      if (offset == mean_bytes) offset += kNormals * sizeof(float);
    }
    file_.write(block.data(), block.size());
  }
  n_written_ += n;
}

void SplatPlyWriter::commit() {
  B3DGS_CHECK(n_written_ == count_, "expected ", count_, " rows, found ", n_written_);
  file_.commit();
}

void write_splat_ply(const std::filesystem::path& path, const SplatCloud& cloud) {
  SplatPlyWriter file(path, cloud.size(), cloud.sh_degree, cloud.antialiased, cloud.frame);
  file.append(cloud);
  file.commit();
}

bool is_splat_ply(const std::filesystem::path& path) {
  FileReader file(path);
  const PlyReader reader(file);
  refuse_other_ply(reader);
  return holds_gaussians(reader.vertices());
}

SplatCloud read_splat_ply(const std::filesystem::path& path) {
  FileReader file(path);
  return read_splat_ply(file);
}

SplatCloud read_splat_ply(FileReader& file) {
  constexpr const char *kCounted = " (counted from 0): ", *kRemedy = "; remove this Gaussian or export the file again";
  PlyReader reader(file);
  refuse_other_ply(reader);
  const PlyElement& vertices = reader.vertices();
  if (!holds_gaussians(vertices)) {
    input_error(file.name(), ": no Gaussians, but points or a mesh: the vertices have no property f_dc_0, scale_0 or ",
                "rot_0; a training can start from points: b3dgs train SCENE --init_ply FILE");
  }
  const PlyProperty* const red = vertices.find("f_dc_0") ? nullptr : vertices.find(kColors[0]);
  if (!vertices.find("f_dc_0") && !red) {
    input_error(file.name(),
                ": Gaussians without colours: expected the properties f_dc_0 to f_dc_2, or red, green and ",
                "blue, found neither; export the file again with colours");
  }
  SplatCloud cloud;
  cloud.sh_degree = sh_degree_of(reader);
  cloud.antialiased = is_antialiased(reader, cloud.notes);
  const std::uint64_t n = vertices.count;
  std::vector<double> positions(3 * n);
  const std::vector<Property> properties = properties_of(cloud.sh_degree);
  std::vector<std::string> columns;
  for (const Property& property : properties) {
    const bool is_color = red && property.values == &SplatCloud::sh0;
    columns.push_back(is_color ? kColors[property.column] : property.name);
    (cloud.*property.values).resize(n * property.width);
  }
  std::vector<float> filters;
  if (vertices.find(kFilter)) {
    columns.emplace_back(kFilter);
    filters.resize(n);
  }
  note_others(reader, columns, cloud.notes);
  std::int64_t n_infinite_scales = 0;
  reader.read_vertices(columns, [&](std::uint64_t first, std::uint64_t n_rows, const double* rows) {
    const auto check = [&](bool is_valid, std::uint64_t i, std::size_t k) {
      if (is_valid) return;
      input_error(reader.name(), ": row ", first + i, kCounted, "expected a finite ", columns[k], ", found ",
                  rows[i * columns.size() + k], kRemedy);
    };
    for (std::size_t k = 0; k < properties.size(); ++k) {
      const Property& property = properties[k];
      const bool is_mean = property.values == &SplatCloud::means;
      const bool is_opacity = property.values == &SplatCloud::logit_opacities;
      const bool is_scale = property.values == &SplatCloud::log_scales;
      const bool is_color = red && property.values == &SplatCloud::sh0;
      float* const to = (cloud.*property.values).data() + property.column;
      for (std::uint64_t i = 0; i < n_rows; ++i) {
        double value = rows[i * columns.size() + k];
        if (is_color) value = (value * color_factor(*red) / 255 - 0.5) / kSh0;
        const auto single = static_cast<float>(value);
        check(is_opacity || is_scale ? !std::isnan(value) : std::isfinite(single), i, k);
        if (is_mean) positions[3 * (first + i) + property.column] = value;
        const double limit = std::copysign(is_scale ? kLargestLogScale : kLargestLogit, value);
        to[(first + i) * property.width] = std::isinf(single) ? static_cast<float>(limit) : single;
        n_infinite_scales += is_scale && std::isinf(single) ? 1 : 0;
      }
    }
    for (std::uint64_t i = 0; i < n_rows && !filters.empty(); ++i) {
      const std::size_t k = columns.size() - 1;
      filters[first + i] = static_cast<float>(rows[i * columns.size() + k]);
      check(std::isfinite(filters[first + i]), i, k);
    }
  });
  for (std::uint64_t row = 0; row < n; ++row) {
    const float* const quat = &cloud.quats[4 * row];
    if (quat[0] != 0 || quat[1] != 0 || quat[2] != 0 || quat[3] != 0) continue;
    input_error(reader.name(), ": row ", row, kCounted,
                "expected a rotation quaternion rot_0..3, found one of length 0", kRemedy);
  }
  if (n_infinite_scales > 0) {
    cloud.notes.push_back(detail::concat(
        reader.name(), ": ", format_count(n_infinite_scales), " of ", format_count(static_cast<std::int64_t>(3 * n)),
        " scales are infinite; -inf was read as ", -kLargestLogScale, ", inf as ", kLargestLogScale));
  }
  if (!filters.empty()) {
    include_filters(filters, cloud);
    cloud.notes.push_back(reader.name() + ": the 3D filter of Mip-Splatting (property filter_3D) was applied to " +
                          "scales and opacities");
  }
  cloud.frame = frame_of_file(positions);
  for (std::size_t i = 0; i < positions.size(); i += 3) {
    const std::array<double, 3> local = cloud.frame.from_world(&positions[i]);
    for (std::size_t axis = 0; axis < 3; ++axis) cloud.means[i + axis] = static_cast<float>(local[axis]);
  }
  const double log_unit = std::log(cloud.frame.unit);
  for (float& scale : cloud.log_scales) scale = static_cast<float>(scale - log_unit);
  return cloud;
}

}  // namespace b3dgs
