// The "Words" section of a report: terms that the other sections use without explaining them.
#include "report/report_sections.h"

namespace b3dgs {

std::string words_section() {
  const std::vector<html::Row> rows{
      {"PSNR, SSIM", "Quality of a render against its photograph; higher is better."},
      {"percentile", "90 % of the values are at or below the 90th percentile; half of them at or below the median."},
      {"tile", "16 x 16 or 16 x 8 pixels with a list of the Gaussians that touch them, sorted by depth."},
      {"saturated pixel", "So opaque that the Gaussians further behind are not processed: they would not be seen."},
      {"Gini coefficient", "How uneven the work is: 0 if all tiles or pixels have the same, 1 if one has it all."},
      {"forward, backward pass", "From Gaussians to an image; from the error of the image to their gradients."},
      {"blending kernel",
       "Combines the Gaussians of a tile into pixels (forward), or adds up their gradients (backward). The candidates "
       "compute the same, but divide the work differently, so their times differ."},
      {"timing check",
       "The candidates are timed on the same views. Training switches to another one if it is clearly faster."},
      {"warp, thread block", "Groups of GPU threads: the 32 threads of a warp run in step; a block is 1 to 32 warps."},
      {"density control", "Adding Gaussians where detail is missing, and removing transparent ones."},
      {"session", "The part of a training that one run of the program did; each resume begins another."}};
  return html::table({}, rows, html::Columns::kWords);
}

}  // namespace b3dgs
