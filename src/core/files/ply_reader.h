// The PLY container: the header, and columns of numbers by name, of any type and in any order.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/files/file_reader.h"

namespace b3dgs {

enum class PlyFormat { kAscii, kLittleEndian, kBigEndian };
enum class PlyType { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat32, kFloat64 };

struct PlyProperty {
  std::string name;
  PlyType type = PlyType::kFloat32;  // of the value, or of a list's elements
  bool is_list = false;
  PlyType count_type = PlyType::kUint8;  // of a list's length
  std::ptrdiff_t target = -1;            // index in the requested columns, any for a list; -1: not requested
};

/// Returns the factor that scales values of a colour to 0 to 255.
inline double color_factor(const PlyProperty& color) {
  return color.type >= PlyType::kFloat32 ? 255.0 : color.type == PlyType::kUint16 ? 1.0 / 257.0 : 1.0;
}

struct PlyElement {
  std::string name;
  std::uint64_t count = 0;
  std::vector<PlyProperty> properties;

  /// Returns null if there is no such property.
  const PlyProperty* find(const std::string& property) const;
};

class PlyReader {
 public:
  /// Reads the header of `file`, which must outlive the reader. @throws InputError
  explicit PlyReader(FileReader& file);

  std::string name() const { return file_.name(); }

  /// Returns the element "vertex". @throws InputError if the file has none
  const PlyElement& vertices() const;

  /// Returns the texts of the header's comment lines.
  const std::vector<std::string>& comments() const { return comments_; }

  /// `values` is [n_rows, columns.size()], starting at row `first_row`.
  using RowsFn = std::function<void(std::uint64_t first_row, std::uint64_t n_rows, const double* values)>;

  /// Reads the vertices once, front to back, and passes them to `on_rows` in blocks of a few thousand rows.
  /// @throws InputError if a column is missing or a list, or the file is too short or too long
  void read_vertices(const std::vector<std::string>& columns, const RowsFn& on_rows);

  using ListFn = std::function<void(std::uint64_t row, const std::vector<double>& values)>;

  /// Reads a list of each row of an element that follows the vertices, after read_vertices(). The list has one of
  /// `names`. Does nothing if there is no such element. @throws InputError if it has no such list, or the file is too
  /// short or too long
  void read_lists(const std::string& element, const std::vector<std::string>& names, const ListFn& on_list);

 private:
  void read_header();
  void check_size() const;
  void read_element(const PlyElement& element, std::size_t n_columns, const RowsFn& on_rows);
  void read_fixed_rows(const PlyElement& element, std::uint64_t n_rows, std::size_t n_columns, double* values);
  void read_row_ascii(const PlyElement& element, std::uint64_t row, double* values);
  void read_row_binary(const PlyElement& element, double* values);
  double read_value(PlyType type);

  FileReader& file_;
  PlyFormat format_ = PlyFormat::kLittleEndian;
  std::vector<PlyElement> elements_;
  std::vector<std::string> comments_;
  std::vector<char> row_buffer_;
  std::vector<double> list_;  // values of the requested list in the last row
};

}  // namespace b3dgs
