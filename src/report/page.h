// The template of report.html, which CMake makes of page/.
#pragma once

namespace b3dgs {

/// HTML with style and scripts inside. "@DATA@" stands where the data goes, as JSON.
extern const char* const kReportPage;

}  // namespace b3dgs
