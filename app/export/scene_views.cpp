#include "app/export/scene_views.h"

#include <array>

#include "core/check.h"
#include "core/text.h"
#include "model/raster_input.h"
#include "train/gaussians/gaussian_model.h"

namespace b3dgs {
namespace {

struct FloaterKind {
  const char* name;
  torch::Tensor Floaters::*rows;
};
constexpr std::array<FloaterKind, 4> kFloaterKinds{{{"unseen", &Floaters::unseen},
                                                    {"one_view", &Floaters::one_view},
                                                    {"close", &Floaters::close},
                                                    {"large", &Floaters::large}}};

/// Returns whether `kinds` contains each of kFloaterKinds.
std::array<bool, kFloaterKinds.size()> parse_kinds(const std::string& kinds) {
  std::array<bool, kFloaterKinds.size()> chosen{};
  if (kinds == "all") chosen.fill(true);
  for (TextFields words(kinds); kinds != "all" && !words.empty();) {
    const std::string_view word = words.word();
    bool is_known = false;
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      if (word == kFloaterKinds[i].name) chosen[i] = is_known = true;
    }
    if (!is_known) {
      input_error("--floater_kinds ", kinds, ": expected all, or some of unseen, one_view, close and large, found \"",
                  word, "\"");
    }
  }
  return chosen;
}

}  // namespace

std::vector<double> blend_weight_sums(const LoadedModel& model, const std::vector<View>& views,
                                      const torch::Device& device, StatusLine& status) {
  const torch::NoGradGuard no_grad;
  ModelRenderer renderer(model, device);
  const torch::TensorOptions options = torch::TensorOptions().dtype(torch::kFloat32).device(device);
  const auto zeros = [&] { return torch::zeros({model.splats.size()}, options); };
  torch::Tensor sums = torch::zeros({model.splats.size()}, options.dtype(torch::kFloat64));
  const ProgressFn progress = show_loading(status);
  for (std::size_t i = 0; i < views.size(); ++i) {
    const RenderedView rendered = renderer.render(to_camera_view(views[i].camera));
    const GaussianScores scores{zeros(), zeros(), zeros(), zeros()};
    renderer.rasterizer.score(torch::zeros_like(rendered.alpha), scores);
    sums += scores.weight_sum;
    progress("contributions of Gaussians", i + 1, views.size());
  }
  status.clear();
  const torch::Tensor host = sums.to(torch::kCPU).contiguous();
  return {host.data_ptr<double>(), host.data_ptr<double>() + host.numel()};
}

void check_floater_kinds(const std::string& kinds) {
  parse_kinds(kinds);
}

PossibleFloaters possible_floaters(const LoadedModel& model, const std::string& kinds, const torch::Device& device,
                                   StatusLine& status) {
  if (model.scene.train.empty()) input_error("--remove_floaters needs the training views; name the scene with -s");
  const torch::NoGradGuard no_grad;
  ModelRenderer renderer(model, device);
  std::vector<CameraView> views;
  for (const View& view : model.scene.train) views.push_back(to_camera_view(view.camera));
  status.show("looking for floaters", /*now=*/true);
  const Floaters floaters = find_floaters(renderer.rasterizer, renderer.gaussians, views, renderer.settings);
  status.clear();
  const auto chosen = parse_kinds(kinds);
  PossibleFloaters result;
  std::string kept;
  torch::Tensor any = torch::zeros_like(floaters.unseen);
  for (std::size_t i = 0; i < chosen.size(); ++i) {
    const torch::Tensor& rows = floaters.*kFloaterKinds[i].rows;
    std::string& counts = chosen[i] ? result.counts : kept;
    counts +=
        (counts.empty() ? "" : ", ") + format_count(rows.sum().item<std::int64_t>()) + " " + kFloaterKinds[i].name;
    if (chosen[i]) any.logical_or_(rows);
  }
  if (!kept.empty()) result.counts += "; kept: " + kept;
  const torch::Tensor host = any.to(torch::kCPU).contiguous();
  result.is_one.assign(host.data_ptr<bool>(), host.data_ptr<bool>() + host.numel());
  return result;
}

}  // namespace b3dgs
