#include "reconstruct/sharpness.h"

#include <opencv2/imgproc.hpp>

namespace b3dgs {

double sharpness(const std::uint8_t* grey, int width, int height) {
  const cv::Mat image(height, width, CV_8U, const_cast<std::uint8_t*>(grey));
  cv::Mat laplacian;
  cv::Laplacian(image, laplacian, CV_32F);
  cv::Scalar mean, deviation;
  cv::meanStdDev(laplacian, mean, deviation);
  return deviation[0] * deviation[0];
}

}  // namespace b3dgs
