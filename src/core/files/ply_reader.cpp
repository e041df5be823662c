#include "core/files/ply_reader.h"

#include <algorithm>
#include <array>
#include <utility>

#include "core/check.h"
#include "core/text.h"

namespace b3dgs {
namespace {

constexpr std::uint64_t kRowsPerBlock = 4096;
constexpr int kMaxHeaderLines = 4096;  // far more than any real file has

template <class T>
double to_double(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof(T));
  return static_cast<double>(value);
}

struct PlyTypeRow {
  const char *name, *other_name;
  int bytes;
  double (*decode)(const char* bytes);
};

/// Properties of the types, in the order of PlyType.
constexpr PlyTypeRow kTypes[] = {
    {"char", "int8", 1, to_double<std::int8_t>},    {"uchar", "uint8", 1, to_double<std::uint8_t>},
    {"short", "int16", 2, to_double<std::int16_t>}, {"ushort", "uint16", 2, to_double<std::uint16_t>},
    {"int", "int32", 4, to_double<std::int32_t>},   {"uint", "uint32", 4, to_double<std::uint32_t>},
    {"float", "float32", 4, to_double<float>},      {"double", "float64", 8, to_double<double>}};

constexpr std::pair<const char*, PlyFormat> kFormats[] = {{"ascii", PlyFormat::kAscii},
                                                          {"binary_little_endian", PlyFormat::kLittleEndian},
                                                          {"binary_big_endian", PlyFormat::kBigEndian}};

const PlyTypeRow& row_of(PlyType type) {
  return kTypes[static_cast<std::size_t>(type)];
}

int bytes_of(PlyType type) {
  return row_of(type).bytes;
}

PlyType type_from_name(std::string_view name, const std::string& place) {
  for (std::size_t i = 0; i < std::size(kTypes); ++i) {
    if (name == kTypes[i].name || name == kTypes[i].other_name) return static_cast<PlyType>(i);
  }
  input_error(place, ": expected a property type such as float or uchar, found \"", name, "\"");
}

double decode(PlyType type, const char* bytes, PlyFormat format) {
  if (format != PlyFormat::kBigEndian) return row_of(type).decode(bytes);
  std::array<char, 8> swapped{};
  std::reverse_copy(bytes, bytes + bytes_of(type), swapped.begin());
  return row_of(type).decode(swapped.data());
}

// Returns the smallest size of a row: empty lists, and ASCII values of one digit with a separator.
std::uint64_t min_row_bytes(const PlyElement& element, PlyFormat format) {
  std::uint64_t bytes = 0;
  for (const PlyProperty& property : element.properties) {
    bytes += format == PlyFormat::kAscii ? 2 : bytes_of(property.is_list ? property.count_type : property.type);
  }
  return bytes;
}

PlyProperty parse_property(TextFields& fields, const std::string& place) {
  PlyProperty property;
  std::string_view type = fields.word();
  property.is_list = type == "list";
  if (property.is_list) {
    property.count_type = type_from_name(fields.word(), place);
    if (property.count_type >= PlyType::kFloat32)
      input_error(place, ": expected an integer type for the length of a list");
    type = fields.word();
  }
  property.type = type_from_name(type, place);
  property.name = fields.word();
  if (property.name.empty()) input_error(place, ": expected the property's name, found the end of the line");
  return property;
}

/// Checks a list length. `most` is the number of elements that fit into the rest of the file.
std::uint64_t list_length(double length, std::uint64_t most, const FileReader& file) {
  if (!(length >= 0 && length <= static_cast<double>(most))) {
    input_error(file.name(), ": expected a list of length 0 to ", most, ", found length ", length,
                "; the file is damaged");
  }
  return static_cast<std::uint64_t>(length);
}

}  // namespace

const PlyProperty* PlyElement::find(const std::string& property) const {
  const auto found = std::find_if(properties.begin(), properties.end(),
                                  [&](const PlyProperty& candidate) { return candidate.name == property; });
  return found == properties.end() ? nullptr : &*found;
}

PlyReader::PlyReader(FileReader& file) : file_(file) {
  read_header();
  check_size();
}

void PlyReader::read_header() {
  std::string_view line;
  if (!file_.read_line(line) || line != "ply") {
    input_error(name(), ": not a PLY file (expected the first line to be \"ply\"); it is of another format or damaged");
  }
  bool has_format = false;
  for (int n_lines = 0;; ++n_lines) {
    if (n_lines == kMaxHeaderLines || !file_.read_line(line)) {
      input_error(file_.place(),
                  ": expected the PLY header to end with a line \"end_header\"; the file is truncated or damaged");
    }
    TextFields fields(line);
    const std::string_view keyword = fields.word();
    if (keyword == "end_header") break;
    if (keyword == "format") {
      const std::string_view format = fields.word();
      const auto known =
          std::find_if(std::begin(kFormats), std::end(kFormats), [&](const auto& row) { return row.first == format; });
      if (known == std::end(kFormats)) {
        input_error(file_.place(), ": expected the format ascii, binary_little_endian or binary_big_endian, found \"",
                    format, "\"");
      }
      has_format = true;
      format_ = known->second;
    } else if (keyword == "element") {
      PlyElement element;
      element.name = fields.word();
      element.count = fields.number<std::uint64_t>("the element's count", [this] { return file_.place(); });
      elements_.push_back(std::move(element));
    } else if (keyword == "property") {
      if (elements_.empty())
        input_error(file_.place(), ": expected an element before the first property; the file is damaged");
      elements_.back().properties.push_back(parse_property(fields, file_.place()));
    } else if (keyword == "comment") {
      comments_.emplace_back(fields.rest());
    } else if (keyword != "obj_info" && !keyword.empty()) {
      input_error(file_.place(), ": expected a PLY header line, found \"", keyword.substr(0, 40), "\"");
    }
  }
  if (!has_format) input_error(name(), ": expected a line \"format\" in the PLY header; the file is damaged");
}

void PlyReader::check_size() const {
  for (const PlyElement& element : elements_) {
    if (element.count == 0) continue;
    if (element.properties.empty())
      input_error(name(), ": element ", element.name, " has no properties; the file is damaged");
    file_.expect_records(("rows of element " + element.name).c_str(), element.count, min_row_bytes(element, format_));
  }
}

const PlyElement& PlyReader::vertices() const {
  std::vector<std::string> names;
  for (const PlyElement& element : elements_) {
    if (element.name == "vertex") return element;
    names.push_back(element.name);
  }
  input_error(name(), ": expected an element \"vertex\", found ", names.empty() ? "none" : list_text(names));
}

void PlyReader::read_vertices(const std::vector<std::string>& columns, const RowsFn& on_rows) {
  PlyElement wanted = vertices();
  for (std::size_t i = 0; i < columns.size(); ++i) {
    const PlyProperty* property = wanted.find(columns[i]);
    if (!property || property->is_list) {
      input_error(name(), ": element ", wanted.name, property ? " has a list as property " : " has no property ",
                  columns[i], property ? ", expected a number" : "; the file is damaged or of another format");
    }
    wanted.properties[static_cast<std::size_t>(property - wanted.properties.data())].target =
        static_cast<std::ptrdiff_t>(i);
  }
  for (const PlyElement& element : elements_) {
    if (&element == &vertices()) break;
    read_element(element, 0, {});
  }
  read_element(wanted, columns.size(), on_rows);
  if (&vertices() == &elements_.back() && format_ != PlyFormat::kAscii) file_.expect_end();
}

void PlyReader::read_lists(const std::string& element, const std::vector<std::string>& names, const ListFn& on_list) {
  auto next = elements_.begin() + (&vertices() - elements_.data()) + 1;
  for (; next != elements_.end() && next->name != element; ++next) read_element(*next, 0, {});
  if (next == elements_.end()) return;
  PlyElement wanted = *next;
  const auto list = std::find_if(wanted.properties.begin(), wanted.properties.end(), [&](const PlyProperty& property) {
    return property.is_list && std::find(names.begin(), names.end(), property.name) != names.end();
  });
  if (list == wanted.properties.end()) {
    input_error(name(), ": element ", element, " has no list ", list_text(names, " or "),
                "; the file is damaged or of another format");
  }
  list->target = 0;
  const std::string kind = "row of element " + element + ",";
  for (std::uint64_t row = 0; row < wanted.count; ++row) {
    list_.clear();
    file_.begin_record(kind.c_str(), row, wanted.count);
    format_ == PlyFormat::kAscii ? read_row_ascii(wanted, row, nullptr) : read_row_binary(wanted, nullptr);
    on_list(row, list_);
  }
  if (next + 1 == elements_.end() && format_ != PlyFormat::kAscii) file_.expect_end();
}

void PlyReader::read_element(const PlyElement& element, std::size_t n_columns, const RowsFn& on_rows) {
  const std::string kind = "row of element " + element.name + ",";
  const bool has_lists = std::any_of(element.properties.begin(), element.properties.end(),
                                     [](const PlyProperty& property) { return property.is_list; });
  std::vector<double> block(std::min(kRowsPerBlock, element.count) * n_columns);
  for (std::uint64_t first = 0; first < element.count; first += kRowsPerBlock) {
    const std::uint64_t n_rows = std::min(kRowsPerBlock, element.count - first);
    file_.begin_record(kind.c_str(), first, element.count);
    if (format_ != PlyFormat::kAscii && !has_lists) {
      read_fixed_rows(element, n_rows, n_columns, block.data());
    } else {
      for (std::uint64_t i = 0; i < n_rows; ++i) {
        double* const values = block.data() + i * n_columns;
        file_.begin_record(kind.c_str(), first + i, element.count);
        format_ == PlyFormat::kAscii ? read_row_ascii(element, first + i, values) : read_row_binary(element, values);
      }
    }
    if (on_rows) on_rows(first, n_rows, block.data());
  }
}

void PlyReader::read_fixed_rows(const PlyElement& element, std::uint64_t n_rows, std::size_t n_columns,
                                double* values) {
  row_buffer_.resize(n_rows * min_row_bytes(element, format_));
  file_.read_bytes(row_buffer_.data(), row_buffer_.size());
  const char* from = row_buffer_.data();
  for (std::uint64_t row = 0; row < n_rows; ++row, values += n_columns) {
    for (const PlyProperty& property : element.properties) {
      if (property.target >= 0) values[property.target] = decode(property.type, from, format_);
      from += bytes_of(property.type);
    }
  }
}

void PlyReader::read_row_ascii(const PlyElement& element, std::uint64_t row, double* values) {
  std::string_view line;
  do {
    if (!file_.read_line(line)) {
      input_error(file_.place(), ": file ends in row ", row + 1, " of ", element.count, " of element ", element.name,
                  "; it is truncated: copy or export it again");
    }
  } while (line.find_first_not_of(" \t") == std::string_view::npos);
  TextFields fields(line);
  for (const PlyProperty& property : element.properties) {
    const auto next = [&] { return fields.number<double>(property.name.c_str(), [this] { return file_.place(); }); };
    const double value = next();
    if (property.is_list) {
      for (std::uint64_t left = list_length(value, line.size(), file_); left > 0; --left) {
        const double entry = next();
        if (property.target >= 0) list_.push_back(entry);
      }
    } else if (property.target >= 0) {
      values[property.target] = value;
    }
  }
}

void PlyReader::read_row_binary(const PlyElement& element, double* values) {
  for (const PlyProperty& property : element.properties) {
    if (property.is_list) {
      const std::uint64_t length = list_length(read_value(property.count_type), file_.remaining(), file_);
      if (property.target < 0) {
        file_.skip(length * static_cast<std::uint64_t>(bytes_of(property.type)));
      } else {
        for (std::uint64_t left = length; left > 0; --left) list_.push_back(read_value(property.type));
      }
    } else if (property.target >= 0) {
      values[property.target] = read_value(property.type);
    } else {
      file_.skip(static_cast<std::uint64_t>(bytes_of(property.type)));
    }
  }
}

double PlyReader::read_value(PlyType type) {
  std::array<char, 8> bytes{};
  file_.read_bytes(bytes.data(), static_cast<std::size_t>(bytes_of(type)));
  return decode(type, bytes.data(), format_);
}

}  // namespace b3dgs
