#include "support/raster/dense_reference.h"

#include <torch/csrc/autograd/autograd.h>

#include <cmath>
#include <sstream>

#include "core/vec.h"

namespace b3dgs::test {
namespace {

using torch::indexing::None;
using torch::indexing::Slice;

constexpr double kCutoff = 1.0 / 255.0;
constexpr double kCap = 0.99;
constexpr double kStop = 1e-4;
constexpr double kBlur = 0.3;    // px^2
constexpr double kMargin = 0.3;  // fraction of half the image
constexpr double kMinRatio = 2.5e-5;

torch::Tensor vector3(const Vec3f& v) {
  return torch::tensor({double{v.x}, double{v.y}, double{v.z}}, torch::kFloat64);
}

torch::Tensor matrix3(const Mat3f& m) {
  torch::Tensor matrix = torch::empty({3, 3}, torch::kFloat64);
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) matrix.index_put_({row, column}, double{m(row, column)});
  }
  return matrix;
}

torch::Tensor column(const torch::Tensor& matrix, int i) {
  return matrix.index({Slice(), i});
}

/// Returns rotation matrices [N, 3, 3] of quaternions [N, 4]: v + 2 w (u x v) + 2 u x (u x v), as a matrix.
torch::Tensor rotations(const torch::Tensor& quats) {
  const torch::Tensor unit = quats / quats.norm(2, 1, true);
  const torch::Tensor w = unit.index({Slice(), 0, None, None});
  const torch::Tensor x = column(unit, 1), y = column(unit, 2), z = column(unit, 3);
  const torch::Tensor zero = torch::zeros_like(x);
  const torch::Tensor cross = torch::stack({zero, -z, y, z, zero, -x, -y, x, zero}, 1).view({-1, 3, 3});
  return torch::eye(3, torch::kFloat64) + 2.0 * w * cross + 2.0 * torch::matmul(cross, cross);
}

/// The pose of a view, with its motion.
struct DensePose {
  torch::Tensor rotation, translation, center;  // [3, 3], [3], [3]

  DensePose(const CameraView& view, const torch::Tensor& motion)
      : rotation(matrix3(view.rotation)), translation(vector3(view.translation)), center(vector3(view.center)) {
    if (!motion.defined()) return;
    const torch::Tensor zero = torch::zeros({}, torch::kFloat64), x = motion[0], y = motion[1], z = motion[2];
    const torch::Tensor turn = torch::matrix_exp(torch::stack({zero, -z, y, z, zero, -x, -y, x, zero}).view({3, 3}));
    rotation = torch::matmul(turn, rotation);
    translation = torch::mv(turn, translation) + motion.slice(0, 3);
    center = -torch::mv(rotation.t(), translation);
  }
};

torch::Tensor weighted_sum(const DenseView& view, const RenderedViewGrad& grad) {
  torch::Tensor sum = torch::zeros({}, torch::kFloat64);
  for (const auto& [image, image_grad] :
       {std::pair(view.color, grad.color), std::pair(view.depth, grad.depth), std::pair(view.alpha, grad.alpha)}) {
    if (image_grad.defined()) sum = sum + (image * image_grad.to(torch::kFloat64)).sum();
  }
  return sum;
}

/// Returns [N, 3] colours before the clamp at 0.
torch::Tensor sh_colors(const GaussianTensors& gaussians, const torch::Tensor& means, const torch::Tensor& rows,
                        const torch::Tensor& camera_center, int degree) {
  const torch::Tensor offset = means - camera_center;
  const torch::Tensor basis = dense_sh_basis(offset / offset.norm(2, 1, true), degree);
  const torch::Tensor coefficients = torch::cat({gaussians.sh0, gaussians.shN}, 1)
                                         .index_select(0, rows)
                                         .index({Slice(), Slice(0, (degree + 1) * (degree + 1))});
  return (basis.unsqueeze(2) * coefficients).sum(1) + 0.5;
}

/// Returns x / z or y / z, clamped to the extended image, for the Jacobian of the projection.
torch::Tensor clamp_slope(const torch::Tensor& slope, double focal, double center, double size) {
  const double margin = kMargin * 0.5 * size / focal;
  return slope.clamp(-center / focal - margin, (size - center) / focal + margin);
}

// Lenses: the base projection and the distortion as torch operations, and autograd for the Jacobian.

constexpr double kMaxLatitude = 86 * kPi / 180;
constexpr double kAngleMargin = 0.35, kMaxSpread = 0.5;

bool sees_all_around(const CameraView& view) {
  return view.lens.kind == LensKind::kEquirectangular ||
         (view.lens.kind == LensKind::kFisheye && view.lens.max_angle > 80 * kPi / 180);
}

/// Returns [N] angles to the axis of points [N, 3].
torch::Tensor angles_to_axis(const torch::Tensor& points) {
  return torch::atan2(points.slice(1, 0, 2).norm(2, 1), column(points, 2));
}

/// Returns pixels [N, 2] in px.
torch::Tensor lens_pixels(const CameraView& view, const torch::Tensor& points) {
  const torch::Tensor x = column(points, 0), y = column(points, 1), z = column(points, 2);
  const auto k = [&](int i) { return double{view.lens.k[i]}; };
  torch::Tensor a = x / z, b = y / z;
  if (view.lens.kind == LensKind::kEquirectangular) {
    return torch::stack({view.fx * torch::atan2(x, z) + double{view.cx},
                         view.fy * torch::atan2(y, (x * x + z * z).sqrt()) + double{view.cy}},
                        1);
  }
  if (view.lens.kind == LensKind::kFisheye) {
    const torch::Tensor rho = (x * x + y * y).sqrt(), scale = torch::atan2(rho, z) / rho;
    a = scale * x;
    b = scale * y;
  }
  const torch::Tensor s = a * a + b * b, r = s.sqrt();
  torch::Tensor factor = (1 + k(0) * s + k(1) * s.pow(2) + k(2) * s.pow(3) + k(3) * s.pow(4)) /
                         (1 + k(4) * s + k(5) * s.pow(2) + k(6) * s.pow(3));
  if (view.lens.kind == LensKind::kFov) factor = torch::atan(2 * std::tan(k(0) / 2) * r) / (k(0) * r);
  if (view.lens.kind == LensKind::kDivision) factor = 2 / (1 + (1 - 4 * k(0) * s).sqrt());
  if (view.lens.kind == LensKind::kEucm) factor = 1 / (k(0) * (k(1) * s + 1).sqrt() + 1 - k(0));
  const torch::Tensor u = a * factor + 2 * k(7) * a * b + k(8) * (s + 2 * a * a) + k(9) * s;
  const torch::Tensor v = b * factor + k(7) * (s + 2 * b * b) + 2 * k(8) * a * b + k(10) * s;
  return torch::stack({view.fx * u + double{view.cx}, view.fy * v + double{view.cy}}, 1);
}

/// Returns the nearest points where the lens is linearised, and which [N] differ from the given points.
std::pair<torch::Tensor, torch::Tensor> limited_points(const CameraView& view, const torch::Tensor& points) {
  const torch::Tensor x = column(points, 0), y = column(points, 1), z = column(points, 2);
  const torch::Tensor t = points.norm(2, 1);
  constexpr double kLeastSquare = 1e-60;  // keeps the gradient finite on the axis, where nothing is limited
  if (view.lens.kind == LensKind::kEquirectangular) {
    const torch::Tensor h = (x * x + z * z).clamp_min(kLeastSquare).sqrt(), latitude = torch::atan2(y, h);
    const torch::Tensor scale = t * std::cos(kMaxLatitude) / h;
    return {torch::stack({scale * x, t * latitude.sign() * std::sin(kMaxLatitude), scale * z}, 1),
            latitude.abs() > kMaxLatitude};
  }
  const double limit = double{view.lens.max_angle};
  const torch::Tensor rho = (x * x + y * y).clamp_min(kLeastSquare).sqrt(), is_limited = angles_to_axis(points) > limit;
  if (view.lens.kind == LensKind::kFisheye) {
    const torch::Tensor scale = t * std::sin(limit) / rho;
    return {torch::stack({scale * x, scale * y, t * std::cos(limit)}, 1), is_limited};
  }
  const torch::Tensor scale = z * std::tan(limit) / rho;
  return {torch::stack({scale * x, scale * y, z}, 1), is_limited};
}

/// Returns projected centres [N, 2] and Jacobians [N, 2, 3] of points [N, 3].
std::pair<torch::Tensor, torch::Tensor> project_through_lens(const CameraView& view, const torch::Tensor& given) {
  const torch::AutoGradMode with_graph(true);
  const torch::Tensor points = given.requires_grad() ? given : given.detach().requires_grad_(true);
  const auto [limited, is_limited] = limited_points(view, points);
  const torch::Tensor at = torch::where(is_limited.unsqueeze(1), limited, points);
  const torch::Tensor pixels = lens_pixels(view, at);
  std::vector<torch::Tensor> rows;
  for (int i = 0; i < 2; ++i) {
    rows.push_back(torch::autograd::grad({column(pixels, i).sum()}, {at}, {}, /*retain_graph=*/true,
                                         /*create_graph=*/true)[0]);
  }
  const torch::Tensor jacobian = torch::stack(rows, 1);
  return {pixels + torch::matmul(jacobian, (points - at).unsqueeze(2)).squeeze(2), jacobian};
}

class HazardList {
 public:
  /// Adds a line for every Gaussian for which `is_close` is true. `rows` are their indices.
  void add(const char* decision, const torch::Tensor& is_close, const torch::Tensor& rows) {
    const torch::Tensor found = rows.masked_select(is_close);
    for (std::int64_t i = 0; i < found.numel(); ++i) {
      std::ostringstream line;
      line << decision << " of Gaussian " << found[i].item<std::int64_t>();
      lines.push_back(line.str());
    }
  }
  std::vector<std::string> lines;
};

torch::Tensor is_near(const torch::Tensor& value, double threshold) {
  return (value - threshold).abs() < kDecisionBand * std::abs(threshold);
}

/// Returns [n_pixels, M] whether the culling square of each Gaussian reaches the tile of each pixel along one axis.
torch::Tensor square_reaches(const torch::Tensor& pixel, const torch::Tensor& mean, const torch::Tensor& radius,
                             int tile, const torch::Tensor& rows, HazardList& hazards) {
  const torch::Tensor lower = (mean - radius) / tile;
  const torch::Tensor upper = (mean + radius) / tile;
  hazards.add("tile range",
              ((lower - lower.round()).abs() < kDecisionBand) | ((upper - upper.round()).abs() < kDecisionBand), rows);
  const torch::Tensor pixel_tile = (pixel / tile).floor().unsqueeze(1);
  return (pixel_tile >= lower.floor()) & (pixel_tile < upper.ceil());
}

/// Returns [M] whether the culling squares overlap a tile along one axis of an image of `size` px. `square_reaches`
/// reports doubtful cases.
torch::Tensor square_meets_a_tile(const torch::Tensor& mean, const torch::Tensor& radius, std::int32_t tile,
                                  std::int64_t size) {
  const auto n_tiles = static_cast<double>((size + tile - 1) / tile);
  return (((mean - radius) / tile).floor().clamp_min(0.0) < ((mean + radius) / tile).ceil().clamp_max(n_tiles));
}

/// The ellipses of M Gaussians. Each member is [M].
struct Ellipses {
  torch::Tensor mean_x, mean_y;  // px
  torch::Tensor xx, xy, yy;      // covariance, px^2
  torch::Tensor rim;             // sigma where alpha is 1/255, negative if it is nowhere
};

/// Returns [M] the least sigma over a rectangle grown by `margin` [M] on each side: 0 at the centre, or of an edge.
torch::Tensor least_sigma(const Ellipses& e, double x_low, double x_high, double y_low, double y_high,
                          const torch::Tensor& margin) {
  const torch::Tensor left = x_low - margin, right = x_high + margin, top = y_low - margin, bottom = y_high + margin;
  const auto sigma = [&](const torch::Tensor& x, const torch::Tensor& y) {
    const torch::Tensor dx = x - e.mean_x, dy = y - e.mean_y;
    return 0.5 * (e.yy * dx * dx - 2.0 * e.xy * dx * dy + e.xx * dy * dy) / (e.xx * e.yy - e.xy * e.xy);
  };
  torch::Tensor least = torch::full_like(e.xx, INFINITY);
  for (const torch::Tensor& x : {left, right}) {
    const torch::Tensor y = e.mean_y + e.xy / e.xx * (x - e.mean_x);  // nearest on the whole line
    least = torch::minimum(least, sigma(x, torch::minimum(torch::maximum(y, top), bottom)));
  }
  for (const torch::Tensor& y : {top, bottom}) {
    const torch::Tensor x = e.mean_x + e.xy / e.yy * (y - e.mean_y);
    least = torch::minimum(least, sigma(torch::minimum(torch::maximum(x, left), right), y));
  }
  const torch::Tensor inside = (e.mean_x >= left) & (e.mean_x <= right) & (e.mean_y >= top) & (e.mean_y <= bottom);
  return torch::where(inside, torch::zeros_like(least), least);
}

/// Returns [M] whether each ellipse meets a tile within `margin` [M].
torch::Tensor meets_a_tile(const Ellipses& e, std::int64_t width, std::int64_t height, TileShape tile,
                           const torch::Tensor& margin) {
  torch::Tensor meets = torch::zeros_like(e.xx, torch::kBool);
  for (std::int64_t y = 0; y < height; y += tile.height) {
    for (std::int64_t x = 0; x < width; x += tile.width) {
      const double left = static_cast<double>(x) + 0.5, top = static_cast<double>(y) + 0.5;
      meets |= least_sigma(e, left, left + tile.width - 1, top, top + tile.height - 1, margin) <= e.rim;
    }
  }
  return meets;
}

}  // namespace

torch::Tensor dense_rotations(const torch::Tensor& quats) {
  return rotations(quats);
}

DenseCenters dense_centers(const torch::Tensor& means, const CameraView& view) {
  DenseCenters out;
  out.rotation = matrix3(view.rotation);
  out.points = (torch::matmul(means, out.rotation.t()) + vector3(view.translation)).detach();
  const torch::Tensor x = column(out.points, 0), y = column(out.points, 1), z = column(out.points, 2);
  const torch::Tensor zero = torch::zeros_like(z);
  out.depth = sees_all_around(view) ? out.points.norm(2, 1) : z;
  out.deeper = sees_all_around(view) ? out.points / out.depth.unsqueeze(1) : torch::stack({zero, zero, zero + 1}, 1);
  if (view.lens.kind == LensKind::kPinhole) {
    out.jacobian = torch::stack({view.fx / z, zero, -view.fx * x / z.square(),  //
                                 zero, view.fy / z, -view.fy * y / z.square()},
                                1)
                       .view({-1, 2, 3});
  } else {
    out.jacobian = project_through_lens(view, out.points).second.detach();
  }
  return out;
}

torch::Tensor dense_sh_basis(const torch::Tensor& directions, int degree) {
  const torch::Tensor x = column(directions, 0), y = column(directions, 1), z = column(directions, 2);
  std::vector<torch::Tensor> basis;
  basis.push_back(torch::full_like(x, 0.5 * std::sqrt(1.0 / kPi)));
  if (degree >= 1) {
    const double c = std::sqrt(3.0 / (4.0 * kPi));
    basis.insert(basis.end(), {-c * y, c * z, -c * x});
  }
  if (degree >= 2) {
    const double c = 0.5 * std::sqrt(15.0 / kPi);
    basis.insert(basis.end(), {c * x * y, -c * y * z, 0.25 * std::sqrt(5.0 / kPi) * (3.0 * z * z - 1.0), -c * x * z,
                               0.5 * c * (x * x - y * y)});
  }
  if (degree >= 3) {
    const double c1 = 0.25 * std::sqrt(21.0 / (2.0 * kPi));
    const double c2 = 0.25 * std::sqrt(105.0 / kPi);
    const double c3 = 0.25 * std::sqrt(35.0 / (2.0 * kPi));
    basis.insert(basis.end(), {-c3 * y * (3.0 * x * x - y * y), 2.0 * c2 * x * y * z, -c1 * y * (5.0 * z * z - 1.0),
                               0.25 * std::sqrt(7.0 / kPi) * z * (5.0 * z * z - 3.0), -c1 * x * (5.0 * z * z - 1.0),
                               c2 * z * (x * x - y * y), -c3 * x * (x * x - 3.0 * y * y)});
  }
  return torch::stack(basis, 1);
}

GaussianTensors to_dense_leaves(const GaussianTensors& gaussians) {
  GaussianTensors leaves = gaussians;
  for (torch::Tensor* group : leaves.all()) *group = group->detach().to(torch::kFloat64).clone().requires_grad_(true);
  if (leaves.filters.defined()) leaves.filters = leaves.filters.to(torch::kFloat64);
  return leaves;
}

DenseView dense_render(const GaussianTensors& leaves, const CameraView& view, const RenderSettings& settings,
                       const torch::Tensor& motion) {
  const std::int64_t width = view.width, height = view.height;
  HazardList hazards;
  DenseView out;

  // Centres, and the visible rows, nearest first.
  const DensePose pose(view, motion);
  const torch::Tensor all_centers = torch::matmul(leaves.means, pose.rotation.t()) + pose.translation;
  const bool is_pinhole = view.lens.kind == LensKind::kPinhole, is_radial = sees_all_around(view);
  const torch::Tensor all_depths = (is_radial ? all_centers.norm(2, 1) : column(all_centers, 2)).detach();
  const torch::Tensor all_rows = torch::arange(leaves.size(), torch::kInt64);
  hazards.add("near plane", is_near(all_depths, settings.near_plane), all_rows);
  torch::Tensor is_before = all_depths >= double{settings.near_plane};
  if (view.lens.kind == LensKind::kFisheye) {
    const torch::Tensor angles = angles_to_axis(all_centers.detach());
    hazards.add("largest angle", is_near(angles, view.lens.max_angle + kAngleMargin), all_rows);
    is_before = is_before & (angles <= view.lens.max_angle + kAngleMargin);
  }
  const torch::Tensor seen = all_rows.masked_select(is_before);
  const torch::Tensor order =
      std::get<1>(torch::sort(all_depths.index_select(0, seen), /*stable=*/true, /*dim=*/0, /*descending=*/false));
  const torch::Tensor rows = seen.index_select(0, order);
  const std::int64_t n_seen = rows.numel();

  const torch::Tensor means = leaves.means.index_select(0, rows);
  const torch::Tensor centers = all_centers.index_select(0, rows);
  const torch::Tensor x = column(centers, 0), y = column(centers, 1), z = column(centers, 2);
  const torch::Tensor depth = is_radial ? centers.norm(2, 1) : z;
  if (n_seen > 1) {
    const torch::Tensor gap = depth.detach().diff();
    hazards.add("order", (gap > 0) & (gap < kDecisionBand * depth.detach().slice(0, 1)), rows.slice(0, 1));
  }

  // Projection. means2d is a separate tensor, so that autograd gives a gradient with respect to it.
  torch::Tensor projected = torch::stack({view.fx * x / z + double{view.cx}, view.fy * y / z + double{view.cy}}, 1);
  torch::Tensor jacobian;
  if (!is_pinhole) {
    std::tie(projected, jacobian) = project_through_lens(view, centers);
    const torch::Tensor latitude = torch::atan2(y, (x * x + z * z).sqrt()).detach().abs();
    hazards.add("lens limit",
                view.lens.kind == LensKind::kEquirectangular
                    ? is_near(latitude, kMaxLatitude)
                    : is_near(angles_to_axis(centers.detach()), view.lens.max_angle),
                rows);
  }
  out.means2d = torch::zeros({leaves.size(), 2}, torch::kFloat64).index_copy(0, rows, projected);
  const torch::Tensor means2d = out.means2d.index_select(0, rows);

  if (is_pinhole) {
    const torch::Tensor slope_x = x / z, slope_y = y / z;
    const torch::Tensor clamped_x = clamp_slope(slope_x, view.fx, view.cx, width);
    const torch::Tensor clamped_y = clamp_slope(slope_y, view.fy, view.cy, height);
    for (const auto& [slope, focal, center, size] :
         {std::tuple(slope_x, view.fx, view.cx, width), std::tuple(slope_y, view.fy, view.cy, height)}) {
      const double margin = kMargin * 0.5 * static_cast<double>(size) / focal;
      hazards.add("frustum clamp", is_near(slope.detach(), -double{center} / focal - margin), rows);
      hazards.add("frustum clamp", is_near(slope.detach(), (static_cast<double>(size) - center) / focal + margin),
                  rows);
    }
    const torch::Tensor zero = torch::zeros_like(z);
    jacobian = torch::stack({view.fx / z, zero, -view.fx * (clamped_x * z) / (z * z),  //
                             zero, view.fy / z, -view.fy * (clamped_y * z) / (z * z)},
                            1)
                   .view({-1, 2, 3});
  }
  const torch::Tensor scales = leaves.log_scales.index_select(0, rows).exp();
  torch::Tensor filtered_scales = scales;
  torch::Tensor opacity = torch::sigmoid(leaves.logit_opacities.index_select(0, rows));
  if (settings.antialiasing && leaves.filters.defined()) {
    filtered_scales = (scales.square() + leaves.filters.index_select(0, rows).square().unsqueeze(1)).sqrt();
    opacity = opacity * (scales / filtered_scales).prod(1);
  }
  torch::Tensor drawn_scales = filtered_scales;
  if (is_radial) {  // at most kMaxSpread of the distance; the factor has no gradient
    const torch::Tensor share = filtered_scales.detach().amax(1) / depth.detach();
    hazards.add("largest spread", is_near(share, kMaxSpread), rows);
    drawn_scales = filtered_scales * (kMaxSpread / share).clamp_max(1.0).unsqueeze(1);
  }
  const torch::Tensor spread =
      torch::matmul(rotations(leaves.quats.index_select(0, rows)), torch::diag_embed(drawn_scales));
  const torch::Tensor half = torch::matmul(torch::matmul(jacobian, pose.rotation), spread);
  const torch::Tensor sharp_covariance = torch::matmul(half, half.transpose(1, 2));
  const torch::Tensor covariance = sharp_covariance + kBlur * torch::eye(2, torch::kFloat64);
  const torch::Tensor xx = covariance.index({Slice(), 0, 0});
  const torch::Tensor xy = covariance.index({Slice(), 0, 1});
  const torch::Tensor yy = covariance.index({Slice(), 1, 1});
  const torch::Tensor determinant = xx * yy - xy * xy;
  if (settings.antialiasing) {
    const torch::Tensor ratio = torch::det(sharp_covariance) / determinant;
    hazards.add("smallest opacity factor", is_near(ratio.detach(), kMinRatio), rows);
    opacity = opacity * ratio.clamp_min(kMinRatio).sqrt();
  }

  const torch::Tensor raw_colors = sh_colors(leaves, means, rows, pose.center, settings.sh_degree);
  hazards.add("colour clamp", (raw_colors.detach().abs() < kDecisionBand).any(1), rows);
  const torch::Tensor colors = raw_colors.clamp_min(0.0);

  const torch::Tensor longer_axis = ((xx + yy + ((xx - yy).square() + 4.0 * xy.square()).sqrt()) / 2.0).detach();
  const torch::Tensor extent = 3.0 * longer_axis.sqrt();
  const torch::Tensor radii = extent.ceil();
  out.radii = torch::zeros({leaves.size()}, torch::kInt64).index_copy(0, rows, radii.to(torch::kInt64));

  const torch::Tensor opacities = opacity.detach();
  const Ellipses ellipses{
      column(means2d, 0).detach(), column(means2d, 1).detach(), xx.detach(), xy.detach(), yy.detach(),
      (opacities / kCutoff).log()};
  torch::Tensor touches, nearly_touches;
  if (settings.culling == Culling::kSquare) {
    touches = nearly_touches = square_meets_a_tile(ellipses.mean_x, radii, settings.tile_shape().width, width) &
                               square_meets_a_tile(ellipses.mean_y, radii, settings.tile_shape().height, height);
  } else {
    const torch::Tensor size = (2.0 * ellipses.rim.clamp_min(0.0) * (ellipses.xx + ellipses.yy)).sqrt();
    touches = meets_a_tile(ellipses, width, height, settings.tile_shape(), torch::zeros_like(size));
    nearly_touches = meets_a_tile(ellipses, width, height, settings.tile_shape(), 0.01 + 2e-4 * size);
    const torch::Tensor doubtful = is_near(opacities, kCutoff);
    touches = touches & ~doubtful;
    nearly_touches = nearly_touches | doubtful;
  }
  out.seen = torch::zeros({leaves.size()}, torch::kBool).index_copy(0, rows, touches);
  out.seen_nearly = torch::zeros({leaves.size()}, torch::kBool).index_copy(0, rows, nearly_touches);

  // Compare every pixel with every Gaussian: [n_pixels, n_seen].
  const torch::Tensor pixel_x = torch::arange(width, torch::kFloat64).repeat({height});
  const torch::Tensor pixel_y = torch::arange(height, torch::kFloat64).repeat_interleave(width);
  torch::Tensor dx = pixel_x.unsqueeze(1) + 0.5 - column(means2d, 0);
  if (view.lens.kind == LensKind::kEquirectangular) dx = dx - width * (dx.detach() / width).round();  // nearest copy
  const torch::Tensor dy = pixel_y.unsqueeze(1) + 0.5 - column(means2d, 1);
  const torch::Tensor sigma =
      0.5 * (yy / determinant * dx * dx - 2.0 * xy / determinant * dx * dy + xx / determinant * dy * dy);
  const torch::Tensor uncapped = opacity * torch::exp(-sigma);
  const torch::Tensor capped = uncapped.clamp_max(kCap);

  torch::Tensor reached = uncapped.detach() >= kCutoff;
  torch::Tensor in_reach = torch::ones_like(reached);
  if (settings.culling == Culling::kSquare) {
    hazards.add("radius", (extent - extent.round()).abs() < kDecisionBand * extent, rows);
    const torch::Tensor mean_x = column(means2d, 0).detach(), mean_y = column(means2d, 1).detach();
    in_reach = square_reaches(pixel_x, mean_x, radii, settings.tile_shape().width, rows, hazards);
    if (view.lens.kind == LensKind::kEquirectangular) {  // on the other side of the seam
      for (const auto turn : {-width, width}) {
        in_reach = in_reach | square_reaches(pixel_x, mean_x + turn, radii, settings.tile_shape().width, rows, hazards);
      }
    }
    in_reach = in_reach & square_reaches(pixel_y, mean_y, radii, settings.tile_shape().height, rows, hazards);
    reached = reached & in_reach;
  }

  // Transmittance behind each Gaussian as if no pixel stopped. It decreases monotonically, so it is correct up to the
  // first value below the limit, and everything from there on is skipped.
  const torch::Tensor unstopped = torch::cumprod(1.0 - capped.detach() * reached, 1);
  const torch::Tensor blended = reached & (unstopped >= kStop);
  const torch::Tensor alpha = capped * blended;
  const torch::Tensor ones = torch::ones({width * height, 1}, torch::kFloat64);
  const torch::Tensor transmittance = torch::cat({ones, torch::cumprod(1.0 - alpha, 1)}, 1);
  const torch::Tensor weights = alpha * transmittance.slice(1, 0, n_seen);
  const torch::Tensor remaining = transmittance.select(1, n_seen);

  out.color =
      (torch::matmul(weights, colors) + remaining.unsqueeze(1) * vector3(settings.background)).view({height, width, 3});
  out.depth = torch::mv(weights, settings.inverse_depth ? 1 / depth : depth).view({height, width});
  out.alpha = (1.0 - remaining).view({height, width});

  out.weights = weights.detach();
  out.rows = rows;
  out.n_blended = blended.sum(1).view({height, width});
  out.last_gaussians = torch::full({height, width}, -1, torch::kInt64);
  if (n_seen > 0) {
    const torch::Tensor positions = torch::arange(1, n_seen + 1, torch::kInt64);
    const torch::Tensor last = std::get<0>((blended * positions).max(1));
    const torch::Tensor index = rows.index_select(0, (last - 1).clamp_min(0));
    out.last_gaussians = torch::where(last > 0, index, torch::full_like(index, -1)).view({height, width});
  }
  out.contributes = torch::zeros({leaves.size()}, torch::kBool).index_copy(0, rows, blended.any(0));

  // Decisions behind the end of a pixel do not matter, so only those up to and including the stop count.
  const torch::Tensor before = torch::cat({ones, unstopped}, 1).slice(1, 0, n_seen);
  const torch::Tensor doubtful =
      is_near(uncapped.detach(), kCutoff) | is_near(uncapped.detach(), kCap) | (reached & is_near(unstopped, kStop));
  out.near_decision = (doubtful & in_reach & (before >= kStop * (1.0 - kDecisionBand))).any(1).view({height, width});
  out.hazards = std::move(hazards.lines);
  return out;
}

DenseGradients dense_gradients(const GaussianTensors& leaves, const DenseView& view, const RenderedViewGrad& grad) {
  const torch::Tensor loss = weighted_sum(view, grad);
  std::vector<torch::Tensor> inputs;
  for (const torch::Tensor* group : leaves.all()) inputs.push_back(*group);
  inputs.push_back(view.means2d);
  std::vector<torch::Tensor> found(inputs.size());
  if (loss.requires_grad()) {
    found = torch::autograd::grad({loss}, inputs, /*grad_outputs=*/{}, /*retain_graph=*/true, /*create_graph=*/false,
                                  /*allow_unused=*/true);
  }
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (!found[i].defined()) found[i] = torch::zeros_like(inputs[i]).detach();
  }

  DenseGradients out;
  std::size_t i = 0;
  for (torch::Tensor* group : out.parameters.all()) *group = found[i++];
  out.means2d = found[i];
  return out;
}

torch::Tensor dense_motion_gradient(const torch::Tensor& motion, const DenseView& view, const RenderedViewGrad& grad) {
  const torch::Tensor loss = weighted_sum(view, grad);
  torch::Tensor found;
  if (loss.requires_grad()) {
    found = torch::autograd::grad({loss}, {motion}, /*grad_outputs=*/{}, /*retain_graph=*/true, /*create_graph=*/false,
                                  /*allow_unused=*/true)[0];
  }
  return found.defined() ? found : torch::zeros_like(motion).detach();
}

}  // namespace b3dgs::test
