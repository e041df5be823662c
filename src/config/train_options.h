// The options of training: their names, ranges and help texts, which train_options.cpp lists, so that a changed help
// text compiles one file. Only for those who read, write or show options; others include train_config.h.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <variant>
#include <vector>

#include "config/train_config.h"
#include "core/config.h"

namespace b3dgs {

/// One option. Its references end with the call that hands it out.
template <class Value, class Constraint>
struct OptionOf {
  const Option& option;
  Value& value;  // in the config
  const Constraint& constraint;
  const char* help;
};

/// With the pairs of types that occur.
using TrainOption =
    std::variant<OptionOf<bool, Any>, OptionOf<int, AtLeast>, OptionOf<int, InRange>, OptionOf<std::int64_t, AtLeast>,
                 OptionOf<double, AtLeast>, OptionOf<double, Above>, OptionOf<double, InRange>,
                 OptionOf<std::string, Any>, OptionOf<std::string, OneOf>, OptionOf<std::vector<int>, AtLeast>>;

/// In the order of help texts and config.json.
void for_each_option(TrainConfig& config, const std::function<void(const TrainOption&)>& take);

/// The field list of core/config.h.
template <class Visitor>
void visit_fields(TrainConfig& config, Visitor&& field) {
  for_each_option(config, [&](const TrainOption& any) {
    std::visit([&](const auto& own) { field(own.option, own.value, own.constraint, own.help); }, any);
  });
}

}  // namespace b3dgs
