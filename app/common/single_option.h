// Commands with a single option of their own.
#pragma once

#include "core/config.h"

namespace b3dgs {

/// An option that takes any value.
template <class Value>
struct SingleOption {
  Option option;
  Value value;
  const char* help;
};

template <class Value, class Visitor>
void visit_fields(SingleOption<Value>& single, Visitor&& field) {
  field(single.option, single.value, Any{}, single.help);
}

}  // namespace b3dgs
