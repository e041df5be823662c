// b3dgs view: shows a finished model in a browser.
#include <iostream>

#include "app/common/commands.h"
#include "app/common/single_option.h"
#include "app/common/stop_request.h"
#include "app/common/torch/model.h"
#include "app/view/view_options.h"
#include "app/view/watched_scene.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "train/device.h"

namespace b3dgs {

int run_view(const std::vector<std::string>& words) {
  CommandLine line("view", "Show a model folder or a file of Gaussians in a browser.", "b3dgs view output/garden");
  ModelOptions model_options;
  SingleOption<std::string> page{Option{"view"}.common(), "auto",
                                 "where the page is: PORT, or ADDRESS:PORT (auto = first free port from 8080 on)"};
  line.add(model_options, "Model", {"model_path"});
  line.add(page, "Page");
  line.set_help("model_path", "model folder, or a file of Gaussians");
  if (!line.parse(join_view_place(words))) return 0;
  const ViewServerOptions place = parse_view_place(page.value);

  StatusLine status = StatusLine::for_stderr(model_options.quiet);
  const torch::Device device = choose_device(model_options.device);
  const std::string title = std::filesystem::path(model_options.model_path).lexically_normal().filename().string();
  LoadedModel model = load_model(model_options);
  // With photographs if the scene exists, otherwise with the model folder's cameras, if any.
  if (!model.is_file() || !model_options.source_path.empty()) {
    model.config.eval = model.config.eval || model.is_file();
    const std::string why_not = add_scene_or_cameras(model, model_options, status);
    if (!why_not.empty()) status.warn("no photographs to compare with: " + why_not);
  }
  ModelRenderer renderer(model, device);
  WatchedModel watched({renderer.gaussians, renderer.settings, model.iteration}, model.scene,
                       viewed_scene(model.scene, model.splats.means, title));
  status.clear();
  std::cout << format_count(model.splats.size()) << " Gaussians, " << model.scene.train.size() + model.scene.test.size()
            << " cameras" << std::endl;
  catch_stop_signals();
  const std::unique_ptr<ViewServer> server = start_view_server(watched, place, status);
  std::cout << "            Ctrl-C ends it" << std::endl;
  watched.run(stop_signal());
  return 0;
}

}  // namespace b3dgs
