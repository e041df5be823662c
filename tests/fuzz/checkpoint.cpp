// Checkpoint files. Mutated headers practically never match their checksum, so each input is read twice: unchanged, and
// with the length and checksum of its header corrected.
#include <cmath>
#include <cstring>
#include <optional>

#include "adaptive/kernel_selector.h"
#include "fuzz/fuzz_target.h"
#include "model/checkpoint/checkpoint_header.h"

namespace b3dgs::fuzz {
namespace {

constexpr const char* kName = "a.b3dgs";
constexpr std::size_t kVersionAt = 8, kCrcAt = 12, kLengthAt = 16, kHeaderAt = 24;

void check_header(const CheckpointHeader& header) {
  B3DGS_CHECK(header.iteration >= 0 && header.n_gaussians > 0 && header.adam_steps >= 0 &&
                  header.sh_degree <= header.config.sh_degree && std::isfinite(header.loss_average),
              "a header with values out of range was accepted");
  ViewOrder order = header.view_order;
  const std::int64_t n_views = static_cast<std::int64_t>(header.scene.at("train_views").size());
  if (n_views > 0) {
    const std::int32_t view = order.next(header.config.seed, static_cast<std::int32_t>(n_views));
    B3DGS_CHECK(view >= 0 && view < n_views, "view ", view, " of ", n_views);
  }
}

void restore_selector(const CheckpointHeader& header) {
  KernelSelector selector({"segmented", "sub-tile"});
  selector.restore(header.kernel_selection, "A device", kName);
  selector.to_json("A device");
}

void read_file(std::string_view bytes) {
  FileReader file(kName, bytes);
  const CheckpointLayout layout = read_checkpoint_layout(file);
  const CheckpointHeader header = parse_checkpoint_header(layout.header, kName);
  check_header(header);
  restore_selector(header);
  verify_sections(file, layout);
}

/// Returns the input with a header length that fits the file, and the right checksum.
std::optional<std::string> corrected(std::string_view bytes) {
  if (bytes.size() < kHeaderAt) return std::nullopt;
  std::string file(bytes);
  std::memcpy(file.data(), kCheckpointMagic.data(), kCheckpointMagic.size());
  std::memcpy(file.data() + kVersionAt, &kCheckpointVersion, sizeof kCheckpointVersion);
  std::uint64_t length = 0;
  std::memcpy(&length, file.data() + kLengthAt, sizeof length);
  if (length > file.size() - kHeaderAt) length = file.size() - kHeaderAt;
  // If a mutation moved the end of the header, it is the last brace before a zero byte, because the tensors follow it.
  const std::size_t zero = file.find('\0', kHeaderAt);
  const std::size_t brace = file.rfind('}', zero);
  if (brace != std::string::npos && brace >= kHeaderAt) length = brace + 1 - kHeaderAt;
  std::memcpy(file.data() + kLengthAt, &length, sizeof length);
  const std::uint32_t crc = add_crc(0, file.data() + kHeaderAt, length);
  std::memcpy(file.data() + kCrcAt, &crc, sizeof crc);
  return file;
}

}  // namespace

void read_input(std::string_view bytes) {
  std::optional<InputError> refused;
  try {
    read_file(bytes);
  } catch (const InputError& error) {
    refused = error;
  }
  if (const auto file = corrected(bytes); file && *file != bytes) {
    try {
      read_file(*file);
    } catch (const InputError&) {
    }
  }
  if (refused) throw *refused;
}

}  // namespace b3dgs::fuzz
