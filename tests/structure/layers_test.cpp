// The sources keep to the layers of src/layers.txt, and their folders stay small enough to read at a glance.

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <set>
#include <sstream>
#include <string>
#include <vector>

namespace {

namespace fs = std::filesystem;

const fs::path kRoot = B3DGS_SOURCE;

struct Layer {
  std::string folder;
  std::set<std::string> may_include;  // folders, and "torch"
};

std::vector<Layer> read_layers(std::istream& table) {
  std::vector<Layer> layers;
  for (std::string line; std::getline(table, line);) {
    if (line.empty() || line[0] == '#') continue;
    const std::size_t colon = line.find(':');
    Layer layer{line.substr(0, colon), {}};
    std::istringstream names(line.substr(std::min(line.size(), colon + 1)));
    for (std::string name; names >> name;) layer.may_include.insert(name);
    layers.push_back(layer);
  }
  return layers;
}

/// As the table names them: "raster/cpu/forward/x.cpp", "app/main.cpp".
std::string path_in_table(const fs::path& file) {
  const std::string path = fs::relative(file, kRoot).generic_string();
  return path.compare(0, 4, "src/") == 0 ? path.substr(4) : path;
}

/// The nearest listed folder around a file; null: there is none.
const Layer* layer_of(const std::vector<Layer>& layers, const std::string& path) {
  const Layer* nearest = nullptr;
  for (const Layer& layer : layers) {
    const bool is_inside = path.compare(0, layer.folder.size() + 1, layer.folder + "/") == 0;
    if (is_inside && (nearest == nullptr || layer.folder.size() > nearest->folder.size())) nearest = &layer;
  }
  return nearest;
}

bool is_source(const fs::path& file) {
  static const std::set<std::string> kEndings = {".h", ".cpp", ".cu", ".cuh"};
  return kEndings.count(file.extension().string()) > 0;
}

std::vector<fs::path> sources(std::initializer_list<const char*> folders) {
  std::vector<fs::path> files;
  for (const char* folder : folders) {
    for (const auto& entry : fs::recursive_directory_iterator(kRoot / folder)) {
      if (entry.is_regular_file() && is_source(entry.path())) files.push_back(entry.path());
    }
  }
  std::sort(files.begin(), files.end());
  return files;
}

struct Include {
  bool is_quoted = false;
  std::string path;
};

/// The file that a line includes: `#include "path"` or `#include <path>`.
std::optional<Include> include_of(const std::string& line) {
  std::istringstream words(line);
  std::string word;
  words >> word;
  if (word == "#") {
    words >> word;
    word = "#" + word;
  }
  if (word != "#include" || !(words >> word) || word.size() < 2) return std::nullopt;
  const std::size_t end = word.find(word[0] == '"' ? '"' : '>', 1);
  if ((word[0] != '"' && word[0] != '<') || end == std::string::npos) return std::nullopt;
  return Include{word[0] == '"', word.substr(1, end - 1)};
}

bool starts_with(const std::string& text, const std::string& start) {
  return text.compare(0, start.size(), start) == 0;
}

/// Whether a name in the table stands for a folder: "core" for core, "core/" also for the folders in it.
bool names_folder(const std::string& name, const std::string& folder) {
  return name == folder || (name.back() == '/' && starts_with(folder + "/", name));
}

bool may_include(const Layer& layer, const std::string& folder) {
  return std::any_of(layer.may_include.begin(), layer.may_include.end(),
                     [&](const std::string& name) { return names_folder(name, folder); });
}

/// Returns the fault in one line of a source file, or "".
std::string fault_of_line(const std::vector<Layer>& layers, const std::string& path, const std::string& line) {
  const std::optional<Include> include = include_of(line);
  if (!include) return "";
  const Layer* const own = layer_of(layers, path);
  if (own == nullptr) return path + ": its folder is not in src/layers.txt";
  const std::string& included = include->path;
  if (!include->is_quoted) {
    const bool is_torch =
        starts_with(included, "torch/") || starts_with(included, "ATen/") || starts_with(included, "c10/");
    if (!is_torch || own->may_include.count("torch") > 0) return "";
    return path + ": includes <" + included + ">, but " + own->folder + " may not include torch";
  }
  const Layer* const other = layer_of(layers, included);
  if (other == nullptr) return path + ": includes \"" + included + "\", whose folder is not in src/layers.txt";
  if (other == own || may_include(*own, other->folder)) return "";
  return path + ": includes \"" + included + "\", but " + own->folder + " may not include " + other->folder;
}

std::vector<Layer> project_layers() {
  std::ifstream table(kRoot / "src/layers.txt");
  EXPECT_TRUE(table) << "src/layers.txt";
  return read_layers(table);
}

TEST(Layers, EachFolderNamesOnlyFoldersAboveIt) {
  const std::vector<Layer> layers = project_layers();
  std::set<std::string> above;
  for (const Layer& layer : layers) {
    for (const std::string& name : layer.may_include) {
      bool is_any = name == "torch";
      for (const Layer& other : layers) {
        if (!names_folder(name, other.folder)) continue;
        is_any = true;
        EXPECT_EQ(above.count(other.folder), 1u) << layer.folder << " names " << name;
      }
      EXPECT_TRUE(is_any) << layer.folder << " names " << name << ", which is not listed";
    }
    EXPECT_TRUE(above.insert(layer.folder).second) << layer.folder << " is listed twice";
    EXPECT_LE(layer.may_include.size(), starts_with(layer.folder, "app") ? 12u : 24u)
        << layer.folder << " names too many folders; divide it";
  }
}

TEST(Layers, SourcesIncludeWhatTheTableAllows) {
  const std::vector<Layer> layers = project_layers();
  const std::vector<fs::path> files = sources({"src", "app", "data_synth"});
  EXPECT_GT(files.size(), 200u);
  for (const fs::path& file : files) {
    std::ifstream text(file);
    for (std::string line; std::getline(text, line);) {
      const std::string fault = fault_of_line(layers, path_in_table(file), line);
      EXPECT_TRUE(fault.empty()) << fault;
    }
  }
}

TEST(Layers, TheTableNamesNoIncludeThatIsNotThere) {
  const std::vector<Layer> layers = project_layers();
  std::map<std::string, std::set<std::string>> used;
  for (const fs::path& file : sources({"src", "app", "data_synth"})) {
    const Layer* const own = layer_of(layers, path_in_table(file));
    ASSERT_NE(own, nullptr) << file;
    std::ifstream text(file);
    for (std::string line; std::getline(text, line);) {
      const std::optional<Include> include = include_of(line);
      if (!include || !include->is_quoted) continue;
      if (const Layer* const other = layer_of(layers, include->path); other != nullptr) {
        used[own->folder].insert(other->folder);
      }
    }
  }
  for (const Layer& layer : layers) {
    for (const std::string& name : layer.may_include) {
      const std::set<std::string>& folders = used[layer.folder];
      const auto n_used = std::count_if(folders.begin(), folders.end(),
                                        [&](const std::string& folder) { return names_folder(name, folder); });
      const int n_least = name == "torch" ? 0 : name.back() == '/' ? 2 : 1;
      EXPECT_GE(n_used, n_least) << layer.folder << " names " << name << ", but does not include "
                                 << (n_least == 2 ? "two of its folders" : "it");
    }
  }
}

TEST(Layers, AWrongIncludeIsFound) {
  std::istringstream table("# a comment\ncore:\ncore/files: core\nraster: core torch\napp: core/\n");
  const std::vector<Layer> layers = read_layers(table);
  const auto fault = [&](const char* path, const char* line) { return fault_of_line(layers, path, line); };
  EXPECT_EQ(fault("raster/cpu/a.cpp", "#include \"core/a.h\""), "");
  EXPECT_EQ(fault("raster/cpu/a.cpp", "#include \"raster/b.h\""), "");
  EXPECT_EQ(fault("raster/a.cpp", "#include <torch/types.h>"), "");
  EXPECT_EQ(fault("app/a.cpp", "#include \"core/files/a.h\""), "");
  EXPECT_EQ(fault("core/a.h", "int x;  // \"raster/b.h\""), "");
  EXPECT_EQ(fault("core/a.h", "#include \"raster/b.h\""),
            "core/a.h: includes \"raster/b.h\", but core may not include raster");
  EXPECT_EQ(fault("core/a.h", "# include \"core/files/b.h\"  // why"),
            "core/a.h: includes \"core/files/b.h\", but core may not include core/files");
  EXPECT_EQ(fault("core/a.h", "#include <c10/core/Device.h>"),
            "core/a.h: includes <c10/core/Device.h>, but core may not include torch");
  EXPECT_EQ(fault("core/a.h", "#include \"new/b.h\""),
            "core/a.h: includes \"new/b.h\", whose folder is not in src/layers.txt");
}

// core/files/folders.h has the reason.
TEST(Calls, FoldersAreRemovedByRemoveTree) {
  const std::string call = std::string("remove_all") + "(";  // in two parts, so that this line is not a call
  for (const fs::path& file : sources({"src", "app", "data_synth", "tests"})) {
    std::ifstream text(file);
    for (std::string line; std::getline(text, line);) {
      EXPECT_EQ(line.find(call), std::string::npos) << fs::relative(file, kRoot) << ": " << line;
    }
  }
}

// It takes ten seconds to parse; torch/types.h, which is precompiled, has what tensors need.
TEST(Includes, AllOfLibTorchIsIncludedNowhere) {
  const std::string include = "#include <torch/torch" + std::string(".h>");
  for (const fs::path& file : sources({"src", "app", "tests"})) {
    std::ifstream text(file);
    for (std::string line; std::getline(text, line);) {
      EXPECT_EQ(line.find(include), std::string::npos) << fs::relative(file, kRoot);
    }
  }
}

TEST(Folders, NoneHoldsAThirdOfTheSources) {
  std::map<std::string, std::size_t> lines;
  std::size_t all = 0;
  for (const fs::path& file : sources({"src", "app", "data_synth"})) {
    std::ifstream text(file);
    std::size_t n = 0;
    for (std::string line; std::getline(text, line);) ++n;
    const std::string path = path_in_table(file);
    lines[path.substr(0, path.find('/'))] += n;
    all += n;
  }
  for (const auto& [folder, n] : lines) EXPECT_LT(3 * n, all) << folder << " has " << n << " of " << all << " lines";
}

}  // namespace
