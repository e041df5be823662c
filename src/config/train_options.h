// The names, ranges and help texts of the training options. train_options.cpp lists them, so that only one file is
// compiled after a help text changes. Only for code that reads, writes or shows options. Other code includes
// train_config.h.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <variant>
#include <vector>

#include "config/train_config.h"
#include "core/config.h"

namespace b3dgs {

/// One option. Its references are valid only during the call that receives it.
template <class Value, class Constraint>
struct OptionOf {
  const Option& option;
  Value& value;  // in the config
  const Constraint& constraint;
  const char* help;
};

/// The combinations of types that occur.
using TrainOption =
    std::variant<OptionOf<bool, Any>, OptionOf<int, AtLeast>, OptionOf<int, InRange>, OptionOf<std::int64_t, AtLeast>,
                 OptionOf<double, AtLeast>, OptionOf<double, Above>, OptionOf<double, InRange>,
                 OptionOf<std::string, Any>, OptionOf<std::string, OneOf>, OptionOf<Strategy, OneOf>,
                 OptionOf<MaskMode, OneOf>, OptionOf<Culling, OneOf>, OptionOf<std::vector<int>, AtLeast>>;

/// Calls take() for each option, in the order of help texts and config.json.
void for_each_option(TrainConfig& config, const std::function<void(const TrainOption&)>& take);

/// The field list of core/config.h.
template <class Visitor>
void visit_fields(TrainConfig& config, Visitor&& field) {
  for_each_option(config, [&](const TrainOption& any) {
    std::visit([&](const auto& own) { field(own.option, own.value, own.constraint, own.help); }, any);
  });
}

}  // namespace b3dgs
