#include "app/export/splat_transform.h"

#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <string_view>
#include <vector>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "core/files/folders.h"
#include "core/process/child_process.h"
#include "core/text.h"
#include "model/formats/las.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr const char* kProgram = "splat-transform";
constexpr const char* kSuffixes[] = {".compressed.ply", ".sog", ".html"};  // formats that can be read back

/// Compares with the end of the name, in lower case.
bool ends_with(const fs::path& file, const std::string& end) {
  const std::string name = lower_case(file.filename().string());
  return name.size() >= end.size() && name.compare(name.size() - end.size(), end.size(), end) == 0;
}

/// Removes control sequences, symbols and words in front of the error, and the path of `folder`.
std::string plain_text(std::string line, const fs::path& folder) {
  const std::string path = folder.string() + "/";
  for (std::size_t at = line.find(path); at != std::string::npos; at = line.find(path)) line.erase(at, path.size());
  const std::size_t error = line.find("Error: ");
  if (error != std::string::npos) return line.substr(error);
  return {std::find_if(line.begin(), line.end(), [](unsigned char c) { return std::isalpha(c) != 0; }), line.end()};
}

struct Conversion {
  bool has_written = false, is_stopped = false;  // stopped by a signal
  std::string reason;                            // reason of a failure
};

/// `settings` is a file for the viewer of a page, or empty.
Conversion convert(const fs::path& from, const fs::path& to, bool on_cpu, const fs::path& settings = {}) {
  std::vector<std::string> words{kProgram, "-q", "-w"};
  if (on_cpu) words.insert(words.end(), {"-g", "cpu"});
  if (!settings.empty()) words.insert(words.end(), {"-E", settings.string()});
  words.insert(words.end(), {from.string(), to.string()});
  std::string first, reason;
  const ChildResult result = run_program_lines(words, [&](const std::string& line) {
    const std::string text = plain_text(line, to.parent_path());
    if (first.empty()) first = text;
    if (reason.empty() && text.find("rror") != std::string::npos) reason = text;
  });
  if (reason.empty()) reason = first;
  if (!result.succeeded()) reason = describe(result) + (reason.empty() ? "" : ": ") + reason;
  std::error_code error;
  return {result.succeeded() && fs::file_size(to, error) > 0 && !error, result.signal != 0, reason};
}

/// Returns the SOG file, a zip archive, that the viewer in a page loads from a data URL, or "" if there is none.
std::string sog_in_page(const fs::path& page) {
  constexpr const char* kZipInBase64 = ";base64,UEsDB";  // "PK\3\4"
  constexpr std::string_view kDigits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  const std::string text = read_whole_file(page);
  std::size_t at = text.find(kZipInBase64);
  if (at == std::string::npos) return "";
  at = text.find(',', at) + 1;
  std::string bytes;
  std::uint32_t bits = 0;
  int n_bits = 0;
  for (; at < text.size() && kDigits.find(text[at]) != std::string_view::npos; ++at) {
    bits = bits << 6 | static_cast<std::uint32_t>(kDigits.find(text[at]));
    n_bits += 6;
    if (n_bits < 8) continue;
    n_bits -= 8;
    bytes += static_cast<char>(bits >> n_bits & 255);
  }
  return bytes;
}

/// Replaces the title of a page. Does nothing if it has none.
void set_title(const fs::path& page, const std::string& title) {
  constexpr std::string_view kOpen = "<title>", kClose = "</title>";
  std::string text = read_whole_file(page);
  const std::size_t open = text.find(kOpen), close = text.find(kClose, std::min(open, text.size()));
  if (close == std::string::npos) return;
  std::string escaped;
  for (const char c : title) escaped += c == '&' ? "&amp;" : c == '<' ? "&lt;" : std::string(1, c);
  const std::size_t begin = open + kOpen.size();
  write_file(page, text.replace(begin, close - begin, escaped));
}

}  // namespace

bool is_page(const fs::path& file) {
  return ends_with(file, ".html");
}

bool needs_splat_transform(const fs::path& file) {
  return (!splat_format(file) && !is_las(file)) || ends_with(file, ".compressed.ply");
}

void require_splat_transform(const fs::path& file) {
  if (!find_program(kProgram).empty()) return;
  input_error(
      file.string(), ": b3dgs writes .ply, .spz and .las; other formats, such as .sog and .html, are written by the ",
      "program ", kProgram, ", which is not installed; get it with: npm install -g @playcanvas/splat-transform");
}

void write_by_splat_transform(const fs::path& file, const SplatCloud& cloud, const PageOptions& page,
                              StatusLine& status) {
  const fs::path folder = fs::absolute(file).parent_path();
  create_folder(folder);
  const WorkFolder work(folder);
  const fs::path ply = work.path() / "gaussians.ply", result = work.path() / file.filename();
  write_splat_ply(ply, cloud);
  const fs::path settings = is_page(file) ? work.path() / "settings.json" : fs::path();
  if (is_page(file)) write_file(settings, page.settings);
  status.show(std::string(kProgram) + " writes " + file.filename().string() + ", which may take minutes", /*now=*/true);
  Conversion conversion = convert(ply, result, /*on_cpu=*/false, settings);
  if (!conversion.has_written && !conversion.is_stopped) {
    // Some formats are compressed on a GPU, if the program can use one.
    status.show(std::string(kProgram) + " writes " + file.filename().string() + " without a GPU", /*now=*/true);
    const Conversion again = convert(ply, result, /*on_cpu=*/true, settings);
    if (again.has_written) conversion = again;
  }
  status.clear();
  if (!conversion.has_written) {
    input_error(file.string(), ": ", kProgram, " has not written it (", conversion.reason, ")");
  }
  if (is_page(file)) set_title(result, page.title);
  std::error_code error;
  fs::rename(result, file, error);
  if (error) io_error("cannot write ", file.string(), ": ", error.message());
}

std::optional<SplatCloud> read_by_splat_transform(const fs::path& file, std::string& why_not, StatusLine& status) {
  if (std::none_of(std::begin(kSuffixes), std::end(kSuffixes),
                   [&](const char* suffix) { return ends_with(file, suffix); })) {
    why_not = std::string(kProgram) + " does not read " + file.extension().string();
    return std::nullopt;
  }
  const WorkFolder work(fs::absolute(file).parent_path());
  fs::path source = fs::absolute(file);
  if (is_page(file)) {
    const std::string sog = sog_in_page(file);
    if (sog.empty()) {
      why_not = "no SOG file was found in the page";
      return std::nullopt;
    }
    source = work.path() / "page.sog";
    write_file(source, sog);
  }
  const fs::path ply = work.path() / "back.ply";
  status.show(std::string(kProgram) + " reads " + file.filename().string() + " back", /*now=*/true);
  const Conversion conversion = convert(source, ply, /*on_cpu=*/false);
  status.clear();
  if (!conversion.has_written) {
    why_not = std::string(kProgram) + " cannot read it back (" + conversion.reason + ")";
    return std::nullopt;
  }
  return read_splat_ply(ply);
}

}  // namespace b3dgs
