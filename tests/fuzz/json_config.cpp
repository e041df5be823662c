// Training configurations as JSON: config.json, --config and the header of checkpoints.
#include "config/train_options.h"
#include "core/json_text.h"
#include "fuzz/fuzz_target.h"

void b3dgs::fuzz::read_input(std::string_view bytes) {
  const nlohmann::ordered_json json = parse_json(bytes);
  TrainConfig config;
  config_from_json(config, json, "config.json");  // rejects a discarded value, which is not an object
  TrainConfig again;
  config_from_json(again, config_to_json(config), "again");
  const std::vector<std::string> differences = config_differences(config, again);
  B3DGS_CHECK(differences.empty(), differences.front());
}
