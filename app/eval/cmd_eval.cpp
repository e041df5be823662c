// b3dgs eval: PSNR, SSIM and LPIPS of a trained model.
#include <algorithm>
#include <cstdlib>
#include <iostream>
#include <memory>
#include <optional>

#include "app/common/commands.h"
#include "app/common/torch/model.h"
#include "config/original_options.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/own_files.h"
#include "core/options/command_line.h"
#include "core/task_queue.h"
#include "core/text.h"
#include "model/model_folder.h"
#include "scene/images/image.h"
#include "scene/view_image.h"
#include "train/appearance/appearance_model.h"
#include "train/device.h"
#include "train/evaluate.h"

namespace b3dgs {
namespace {

constexpr int kDifferenceGain = 4;  // the errors of a good model are a few of 255 levels, too small to see

struct EvalOptions {
  std::string split = "auto";
  bool save_images = false;
  std::string lpips;
};

template <class Visitor>
void visit_fields(EvalOptions& c, Visitor&& field) {
  field(Option{"split"}, c.split, OneOf{{"auto", "test", "train", "all"}},
        "views to evaluate; auto: test views, or training views if none were held out");
  field(Option{"save_images"}, c.save_images, Any{},
        "write gt/, renders/, diff/ (4 x difference) and views.json to MODEL/SPLIT/ours_N");
  field(Option{"lpips"}, c.lpips, Any{}, "also compute LPIPS, with this TorchScript network (docs/recipes.md)");
}

Image8 difference(const Image8& a, const Image8& b, const Image8* valid) {
  Image8 result(a.width, a.height, 3);
  for (std::size_t i = 0; i < result.pixels.size(); ++i) {
    const bool is_valid = valid == nullptr || valid->pixels[i / 3] != 0;
    const int amplified = kDifferenceGain * std::abs(int{a.pixels[i]} - int{b.pixels[i]});
    result.pixels[i] = static_cast<std::uint8_t>(is_valid ? std::min(255, amplified) : 0);
  }
  return result;
}

/// Warns if the photographs differ from those that the model was trained on.
void check_photographs(const LoadedModel& model, const std::vector<View>& views, StatusLine& status) {
  const std::vector<std::string> changed = changed_views(model.folder.photographs(), views);
  if (changed.empty()) return;
  status.warn(detail::concat(changed.size(), " of ", views.size(), " photographs have changed since training (",
                             changed.size() > 1 ? "first: " : "", changed.front(),
                             "); PSNR and SSIM refer to the current files"));
}

void print_table(const Evaluation& evaluation) {
  std::size_t columns = 12;
  for (const ViewQuality& view : evaluation.views) columns = std::max(columns, view.name.size());
  for (const std::string& name : evaluation.unmeasured) columns = std::max(columns, name.size());
  const auto print = [&](std::string name, const std::string& rest) {
    name.resize(columns, ' ');
    std::cout << detail::one_line(name) << rest << "\n";
  };
  const auto print_row = [&](const std::string& name, const ImageQuality& quality) {
    std::string row = print_to_string("  %8.3f  %7.4f  %9.3f", quality.psnr, quality.ssim, quality.sharpness);
    if (quality.corrected_psnr) row += print_to_string("  %8.3f", *quality.corrected_psnr);
    if (quality.lpips) row += print_to_string("  %7.4f", *quality.lpips);
    print(name, row);
  };
  print("view", std::string("   PSNR dB     SSIM  sharpness") + (evaluation.mean.corrected_psnr ? "   CC PSNR" : "") +
                    (evaluation.lpips_network.empty() ? "" : "    LPIPS"));
  for (const ViewQuality& view : evaluation.views) print_row(view.name, view.quality);
  for (const std::string& name : evaluation.unmeasured) print(name, "  no valid pixel: not in the mean");
  if (evaluation.views.empty()) return;
  print_row("mean of " + std::to_string(evaluation.views.size()), evaluation.mean);
  std::cout << "sharpness: contrast of fine detail, relative to the photograph\n";
  if (evaluation.mean.corrected_psnr) {
    std::cout << "CC PSNR: colour-corrected, with the colours of each render fitted to its photograph\n";
  }
  if (!evaluation.lpips_network.empty()) std::cout << "LPIPS by the network " << evaluation.lpips_network << "\n";
}

/// Returns how to treat exposure in the views of a split.
ColorEvaluation split_colors(const LoadedModel& model, bool is_test, bool is_other_scene, StatusLine& status) {
  ColorEvaluation colors = color_evaluation(model.config);
  colors.fit_left_half = colors.fit_left_half && is_test;
  if (!model.config.exposure || is_test || is_other_scene) return colors;
  const std::filesystem::path file = model.folder.exposures(model.iteration);
  if (std::filesystem::exists(file)) {
    colors.exposures = read_exposures(file);
  } else {
    status.warn(file.string() + " is missing; training views are compared without their learned exposures");
  }
  return colors;
}

struct SplitEvaluator {
  ModelRenderer renderer;
  bool save_images;
  const LpipsNetwork* lpips;  // may be null
  StatusLine& status;

  /// Saves images to `folder`. `colors`: how to treat exposure.
  Evaluation run(const std::vector<View>& views, const std::string& split, const ColorEvaluation& colors,
                 const std::filesystem::path& folder) {
    const ProgressFn progress = show_loading(status);
    const auto write_images = [&folder](std::size_t index, const View& view, const Image8& image) {
      const std::shared_ptr<const Image8> truth = view.image->read();
      write_image(folder / "gt" / image_name(index), *truth);
      write_image(folder / "renders" / image_name(index), image);
      write_image(folder / "diff" / image_name(index), difference(*truth, image, view.valid.get()));
    };
    TaskQueue tasks(writer_threads(), kFramesAhead);
    const auto on_rendered = [&](std::size_t index, const View& view, const RenderedView& rendered,
                                 const std::optional<ImageQuality>&) {
      if (save_images) {
        const auto image = std::make_shared<const Image8>(to_image8(rendered.color));
        tasks.push([&write_images, index, &view, image] { write_images(index, view, *image); });
      }
      progress("evaluating " + split + " views", index + 1, views.size());
    };
    const RenderFn render = [&](const CameraView& view) { return renderer.render(view); };
    const Evaluation evaluation =
        evaluate_views(render, renderer.gaussians.means.device(), views, on_rendered, lpips, colors);
    tasks.finish();
    status.clear();
    std::cout << split << " views"
              << (!colors.exposures.empty() ? ", with their learned exposures"
                  : colors.fit_left_half    ? ", right half, with colours fitted to the left half (--train_test_exp)"
                                            : "")
              << "\n";
    print_table(evaluation);
    if (save_images) {
      write_view_names(folder, views);
      std::cout << "images: " << folder.string() << "/{gt,renders,diff}; views.json names their views\n";
    }
    return evaluation;
  }
};

/// Returns whether the results can be added to those in the model folder. Otherwise it warns, before anything is
/// rendered. The scene is not read yet, but the training's --eval determines whether there are test views. @throws
/// InputError if --save_images cannot write
bool can_write_results(const LoadedModel& model, const EvalOptions& options, StatusLine& status) {
  const std::string remedy = "allow writing there, or evaluate a copy of the model folder";
  const std::string with_results = model.config.eval ? "test" : "train";
  const std::string split = options.split == "auto" ? with_results : options.split;
  try {
    for (const std::filesystem::path& file : model.folder.results()) {
      if (split == "all" || split == with_results) require_writable(file, remedy);
    }
    if (split == "all" || split == with_results) model.folder.check_results();
  } catch (const InputError& error) {
    if (options.save_images) throw;
    status.warn(std::string("results are printed only: ") + error.what());
    return false;
  }
  for (const std::string part : {"test", "train"}) {
    if (!options.save_images || (split != "all" && split != part)) continue;
    require_writable(model.folder.root() / part / "views.json", remedy);
  }
  return true;
}

/// Evaluates a file of Gaussians, which does not name the views it was trained on. Writes no results files.
void evaluate_file(LoadedModel& model, const EvalOptions& options, const torch::Device& device,
                   const LpipsNetwork* lpips, StatusLine& status) {
  const std::string split = options.split == "auto" ? "all" : options.split;
  const std::filesystem::path images = model.file.parent_path() / (model.file.stem().string() + "_" + split);
  if (options.save_images) {
    require_writable(images / "views.json", "allow writing there, or evaluate a copy of the file");
  }
  model.config.eval = true;  // the test views are those of a training with --eval
  add_scene(model, status);
  const OwnFiles own_files(images);
  std::vector<View> views = split == "test" ? model.scene.test : model.scene.train;
  if (split == "all") {
    views.insert(views.end(), model.scene.test.begin(), model.scene.test.end());
    std::sort(views.begin(), views.end(), [](const View& a, const View& b) { return a.name < b.name; });
  }
  if (views.empty()) {
    input_error(model.config.source_path, ": expected at least one view of --split ", split, ", found none of ",
                model.scene.train.size() + model.scene.test.size(), "; evaluate all with --split all");
  }
  std::cout << model.file.string() << ": " << format_count(model.splats.size()) << " Gaussians\n";
  if (options.split == "auto") {
    std::cout
        << "a file does not say which views it was trained on: evaluating all; --split test for the held-out ones\n";
  }
  SplitEvaluator{{model, device}, options.save_images, lpips, status}.run(views, split, {}, images);
}

}  // namespace

int run_eval(const std::vector<std::string>& words) {
  CommandLine line("eval",
                   "Compute PSNR, SSIM and, with a network, LPIPS of a trained model, or of a file of Gaussians with "
                   "the views of a scene (FILE.ply -s SCENE), for each view and on average.",
                   "b3dgs eval output/garden --save_images");
  ModelOptions model_options;
  EvalOptions options;
  line.add(model_options, "Model", {"model_path"});
  line.add(options, "Evaluation");
  add_original_options(line, OriginalScript::kModel);
  if (!line.parse(words)) return 0;

  StatusLine status = StatusLine::for_stderr(model_options.quiet);
  for (const std::string& text : describe_original_options(line.given(), OriginalScript::kModel)) status.warn(text);
  const torch::Device device = choose_device(model_options.device);
  std::optional<LpipsNetwork> lpips;  // before the photographs, because they take longer to load
  if (!options.lpips.empty()) lpips.emplace(options.lpips, device);
  LoadedModel model = load_model(model_options, /*needs_views=*/true);
  if (model.is_file()) {
    evaluate_file(model, options, device, lpips ? &*lpips : nullptr, status);
    return 0;
  }
  const OwnFiles own_files(model.folder.root());
  const bool writes_results = can_write_results(model, options, status);
  add_scene(model, status);
  const std::string default_split = model.scene.test.empty() ? "train" : "test";
  const std::string split = options.split == "auto" ? default_split : options.split;
  if (split == "test" && model.scene.test.empty()) {
    input_error("no test views: ", model.folder.root().string(),
                " (trained without --eval); evaluate the training views with --split train");
  }
  std::cout << model.folder.root().string() << ": iteration " << model.iteration << ", "
            << format_count(model.splats.size()) << " Gaussians\n";
  if (options.split == "auto" && default_split == "train") {
    std::cout << "no test views (trained without --eval); evaluating the training views\n";
  }

  const EvaluationSource source =
      evaluation_source(model.config, default_split == "test" ? model.scene.test : model.scene.train, default_split);
  const std::string variant = results_variant(model, model_options);
  const std::string key = model.folder.results_key(model.iteration, variant, source);
  const bool is_other_scene = !model_options.source_path.empty() && !variant.empty();
  SplitEvaluator evaluator{{model, device}, options.save_images, lpips ? &*lpips : nullptr, status};
  for (const std::string name : {"test", "train"}) {
    const std::vector<View>& views = name == "test" ? model.scene.test : model.scene.train;
    if (views.empty() || (split != "all" && split != name)) continue;
    if (!is_other_scene) check_photographs(model, views, status);
    const Evaluation evaluation = evaluator.run(
        views, name, split_colors(model, name == "test", is_other_scene, status), model.folder.root() / name / key);
    // The results files have one entry per iteration and scene, for the default split.
    if (name != default_split) continue;
    if (evaluation.views.empty()) {
      status.warn("nothing was measured: the masks leave no valid pixel in any " + name + " view");
      continue;
    }
    if (!writes_results) continue;
    const FolderTurn turn(model.folder.root());
    // Another evaluation with another source may have used the key meanwhile.
    const std::string free_key = model.folder.results_key(model.iteration, variant, source);
    model.folder.write_results(free_key, evaluation, source);
    std::cout << "written: results.json, per_view.json (" << free_key << ")\n";
  }
  return 0;
}

}  // namespace b3dgs
