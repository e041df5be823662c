// The properties of Gaussians in PLY files. Files hold the SH coefficients of f_rest channel by channel,
// the transpose of SplatCloud::shN; only this file deals with that.
#include "model/formats/splat_formats.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <string>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/ply_reader.h"
#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {
namespace {

constexpr std::int64_t kRowsPerBlock = 4096;
constexpr int kMaxShDegree = 3;
// By which viewers know that they have to apply the 2D filter of Mip-Splatting.
constexpr const char* kAntialiasedComment = "SplatRenderMode: mip";

#if defined(__BYTE_ORDER__)
static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "values are written in memory order");
#endif

constexpr const char* kOpacity = "opacity";
// Opacities of 8 bits are often exactly 0 or 1, whose logits are infinite. At this one, opacity is 1 - 3e-7.
constexpr double kLargestLogit = 15;

std::vector<std::string> numbered(const char* prefix, int count) {
  std::vector<std::string> names;
  names.reserve(static_cast<std::size_t>(count));
  for (int i = 0; i < count; ++i) names.push_back(prefix + std::to_string(i));
  return names;
}

// Number of f_rest properties for a degree.
int rest_count(int degree) {
  return 3 * (sh_coefficient_count(degree) - 1);
}

// Calls visit(names of the properties, array [N, number of names]) in the order of the file. Normals are not included:
// they are written as 0 and not read.
template <class Cloud, class Visit>
void visit_fields(Cloud& cloud, Visit&& visit) {
  visit(std::vector<std::string>{"x", "y", "z"}, cloud.means);
  visit(numbered("f_dc_", 3), cloud.sh0);
  visit(numbered("f_rest_", rest_count(cloud.sh_degree)), cloud.shN);
  visit(std::vector<std::string>{kOpacity}, cloud.logit_opacities);
  visit(numbered("scale_", 3), cloud.log_scales);
  visit(numbered("rot_", 4), cloud.quats);
}

// Index in shN, [coefficient, channel], of the f_rest property `index`, [channel, coefficient].
int memory_index(int index, int degree) {
  const int n_coefficients = sh_coefficient_count(degree) - 1;
  return (index % n_coefficients) * 3 + index / n_coefficients;
}

std::string header(std::int64_t count, const std::vector<std::pair<std::string, const char*>>& properties,
                   const std::string& comment = "") {
  std::string text = "ply\nformat binary_little_endian 1.0\n";
  if (!comment.empty()) text += "comment " + comment + "\n";
  text += "element vertex " + std::to_string(count) + "\n";
  for (const auto& [name, type] : properties) text += std::string("property ") + type + " " + name + "\n";
  return text + "end_header\n";
}

/// @throws InputError for formats of other programs that resemble a PLY of Gaussians
int sh_degree_of(const PlyReader& reader) {
  const PlyElement& vertices = reader.vertices();
  const auto n_rest = static_cast<int>(
      std::count_if(vertices.properties.begin(), vertices.properties.end(),
                    [](const PlyProperty& property) { return property.name.rfind("f_rest_", 0) == 0; }));
  for (int degree = 0; degree <= kMaxShDegree; ++degree) {
    if (rest_count(degree) == n_rest) return degree;
  }
  input_error(reader.name(), ": expected 0, 9, 24 or 45 properties f_rest_* (SH degree 0 to 3), found ", n_rest);
}

void check_splat_row(const PlyReader& reader, const std::vector<std::string>& columns, std::uint64_t row,
                     const double* values) {
  const std::string remedy = "; remove this Gaussian or export the file again";
  for (std::size_t i = 0; i < columns.size(); ++i) {
    if (columns[i] == kOpacity && !std::isnan(values[i])) continue;  // limited when it is read
    if (!std::isfinite(static_cast<float>(values[i]))) {
      input_error(reader.name(), ": row ", row, " (counted from 0): expected a finite ", columns[i], ", found ",
                  values[i], remedy);
    }
  }
  const double* quat = values + columns.size() - 4;
  if (quat[0] == 0 && quat[1] == 0 && quat[2] == 0 && quat[3] == 0) {
    input_error(reader.name(), ": row ", row,
                " (counted from 0): expected a rotation quaternion rot_0..3, found one of length 0", remedy);
  }
}

/// The world's, unless it is too far from the Gaussians for single precision.
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
  SplatCloud none;
  none.sh_degree = sh_degree;
  visit_fields(none, [&](const std::vector<std::string>& names, const std::vector<float>& values) {
    const bool are_means = &values == &none.means;
    for (const std::string& name : names)
      properties.emplace_back(name, are_means && frame.is_far() ? "double" : "float");
    if (!are_means) return;
    for (const char* name : {"nx", "ny", "nz"}) properties.emplace_back(name, "float");
  });
  file_.write(header(count, properties, antialiased ? kAntialiasedComment : ""));
}

void SplatPlyWriter::append(const SplatCloud& rows) {
  constexpr std::size_t kNormals = 3;
  const std::int64_t n = rows.size();
  B3DGS_CHECK(rows.sh_degree == sh_degree_ && n_written_ + n <= count_, "expected ", count_, " rows of SH degree ",
              sh_degree_, ", found ", n_written_ + n, " of SH degree ", rows.sh_degree);
  std::size_t n_floats = kNormals;  // beside the means
  visit_fields(rows, [&](const std::vector<std::string>& names, const std::vector<float>& values) {
    B3DGS_CHECK(values.size() == names.size() * static_cast<std::size_t>(n), n, " Gaussians have ", values.size(),
                " values of ", names.size(), " properties");
    if (&values != &rows.means) n_floats += names.size();
  });
  const bool is_far = frame_.is_far();
  const std::size_t mean_bytes = 3 * (is_far ? sizeof(double) : sizeof(float));
  const std::size_t row_bytes = mean_bytes + n_floats * sizeof(float);
  const double log_unit = std::log(frame_.unit);
  std::vector<char> block;
  for (std::int64_t begin = 0; begin < n; begin += kRowsPerBlock) {
    const std::int64_t end = std::min(n, begin + kRowsPerBlock);
    block.assign(static_cast<std::size_t>(end - begin) * row_bytes, 0);  // normals stay 0
    const auto put = [&](std::int64_t row, std::size_t offset, auto value) {
      std::memcpy(block.data() + static_cast<std::size_t>(row - begin) * row_bytes + offset, &value, sizeof value);
    };
    for (std::int64_t row = begin; row < end; ++row) {
      const std::array<double, 3> world = frame_.to_world(&rows.means[static_cast<std::size_t>(3 * row)]);
      for (std::size_t axis = 0; axis < 3; ++axis) {
        if (is_far) {
          put(row, axis * sizeof(double), world[axis]);
        } else {
          put(row, axis * sizeof(float), static_cast<float>(world[axis]));
        }
      }
    }
    std::size_t offset = mean_bytes + kNormals * sizeof(float);
    visit_fields(rows, [&](const std::vector<std::string>& names, const std::vector<float>& values) {
      if (&values == &rows.means) return;
      const bool are_scales = &values == &rows.log_scales;
      const auto width = static_cast<int>(names.size());
      for (int i = 0; i < width; ++i, offset += sizeof(float)) {
        const int source = &values == &rows.shN ? memory_index(i, sh_degree_) : i;
        for (std::int64_t row = begin; row < end; ++row) {
          const float value = values[row * width + source];
          put(row, offset, are_scales ? static_cast<float>(value + log_unit) : value);
        }
      }
    });
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
  return reader.vertices().find("f_dc_0") && reader.vertices().find("opacity");
}

SplatCloud read_splat_ply(const std::filesystem::path& path) {
  FileReader file(path);
  return read_splat_ply(file);
}

SplatCloud read_splat_ply(FileReader& file) {
  PlyReader reader(file);
  refuse_other_ply(reader);
  if (!reader.vertices().find("f_dc_0") && !reader.vertices().find("opacity")) {
    input_error(file.name(), ": no Gaussians, but points or a mesh: the vertices have no property f_dc_0 or opacity; ",
                "a training can start from points: b3dgs train SCENE --init_ply FILE");
  }
  SplatCloud cloud;
  cloud.sh_degree = sh_degree_of(reader);
  const std::vector<std::string>& comments = reader.comments();
  cloud.antialiased = std::find(comments.begin(), comments.end(), kAntialiasedComment) != comments.end();
  const std::uint64_t n = reader.vertices().count;
  std::vector<double> positions(3 * n);
  std::vector<std::string> columns;
  visit_fields(cloud, [&](const std::vector<std::string>& names, std::vector<float>& values) {
    columns.insert(columns.end(), names.begin(), names.end());
    values.resize(n * names.size());
  });
  reader.read_vertices(columns, [&](std::uint64_t first, std::uint64_t n_rows, const double* rows) {
    for (std::uint64_t i = 0; i < n_rows; ++i) check_splat_row(reader, columns, first + i, rows + i * columns.size());
    std::size_t column = 0;
    visit_fields(cloud, [&](const std::vector<std::string>& names, std::vector<float>& values) {
      const auto width = static_cast<int>(names.size());
      for (int k = 0; k < width; ++k, ++column) {
        const int target = &values == &cloud.shN ? memory_index(k, cloud.sh_degree) : k;
        for (std::uint64_t i = 0; i < n_rows; ++i) {
          const double value = rows[i * columns.size() + column];
          if (&values == &cloud.means) {
            positions[3 * (first + i) + static_cast<std::size_t>(k)] = value;
            continue;
          }
          const bool is_infinite = std::isinf(static_cast<float>(value));  // only of an opacity
          values[(first + i) * width + target] =
              static_cast<float>(is_infinite ? std::copysign(kLargestLogit, value) : value);
        }
      }
    });
  });
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
