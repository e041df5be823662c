// train.jsonl. Damaged lines are skipped, so every input is accepted.
#include <sstream>

#include "app/report/train_log_reader.h"
#include "fuzz/fuzz_target.h"

void b3dgs::fuzz::read_input(std::string_view bytes) {
  std::istringstream lines{std::string(bytes)};
  const TrainHistory history = parse_train_log(lines);
  int before = 0;
  for (const LogPoint& point : history.points) {
    B3DGS_CHECK(point.iteration > before, "expected iterations in ascending order, found ", point.iteration, " after ",
                before);
    before = point.iteration;
  }
}
