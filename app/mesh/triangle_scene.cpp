#include "app/mesh/triangle_scene.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "core/check.h"

namespace b3dgs {
namespace {

using Vec = Vec3<double>;

double length(const Vec& v) {
  return std::sqrt(dot(v, v));
}

double distance_from_segment(const Vec& point, const Vec& a, const Vec& b) {
  const Vec edge = b - a, to = point - a;
  const double square = dot(edge, edge);
  const double along = square > 0 ? std::clamp(dot(edge, to) / square, 0.0, 1.0) : 0;
  return length(to - along * edge);
}

struct Query {
  const TriangleMesh& mesh;
  Vec point;
  TriangleScene::Nearest best;
};

bool visit_triangle(RTCPointQueryFunctionArguments* arguments) {
  Query& query = *static_cast<Query*>(arguments->userPtr);
  const TriangleMesh::Triangle& t = query.mesh.triangles[arguments->primID];
  const double distance = distance_from_triangle(query.point, query.mesh.position(t[0]), query.mesh.position(t[1]),
                                                 query.mesh.position(t[2]));
  if (!(distance < query.best.distance)) return false;
  query.best = {distance, arguments->primID};
  // Rounded up, so that triangles at the same distance are not culled.
  arguments->query->radius = std::nextafter(static_cast<float>(distance), std::numeric_limits<float>::infinity());
  return true;
}

}  // namespace

double distance_from_triangle(const Vec& point, const Vec& a, const Vec& b, const Vec& c) {
  const Vec normal = cross(b - a, c - a);
  const double square = dot(normal, normal);
  const bool is_above = square > 0 && dot(cross(b - a, point - a), normal) >= 0 &&
                        dot(cross(c - b, point - b), normal) >= 0 && dot(cross(a - c, point - c), normal) >= 0;
  if (is_above) return std::abs(dot(normal, point - a)) / std::sqrt(square);
  return std::min(
      {distance_from_segment(point, a, b), distance_from_segment(point, b, c), distance_from_segment(point, c, a)});
}

struct TriangleScene::Embree {
  RTCDevice device = rtcNewDevice("threads=1");  // then the tree does not depend on the number of threads
  RTCScene scene = rtcNewScene(device);
  ~Embree() {
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
  }
};

TriangleScene::TriangleScene(const TriangleMesh& mesh) : mesh_(mesh), embree_(std::make_unique<Embree>()) {
  rtcSetSceneFlags(embree_->scene, RTC_SCENE_FLAG_ROBUST);
  const RTCGeometry geometry = rtcNewGeometry(embree_->device, RTC_GEOMETRY_TYPE_TRIANGLE);
  const auto put = [&](RTCBufferType type, RTCFormat format, const auto& values) {
    constexpr std::size_t kBytes = sizeof values[0];
    static_assert(kBytes == 12);
    void* const buffer = rtcSetNewGeometryBuffer(geometry, type, 0, format, kBytes, values.size());
    if (buffer) std::memcpy(buffer, values.data(), kBytes * values.size());
  };
  put(RTC_BUFFER_TYPE_VERTEX, RTC_FORMAT_FLOAT3, mesh.positions);
  put(RTC_BUFFER_TYPE_INDEX, RTC_FORMAT_UINT3, mesh.triangles);
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(embree_->scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(embree_->scene);
  const RTCError error = rtcGetDeviceError(embree_->device);
  B3DGS_CHECK(error == RTC_ERROR_NONE, "Embree reports error ", static_cast<int>(error));
}

TriangleScene::~TriangleScene() = default;

TriangleScene::Nearest TriangleScene::nearest(const Vec& point) const {
  RTCPointQuery query{static_cast<float>(point.x), static_cast<float>(point.y), static_cast<float>(point.z), 0,
                      std::numeric_limits<float>::infinity()};
  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  Query state{mesh_, point, {std::numeric_limits<double>::infinity(), 0}};
  rtcPointQuery(embree_->scene, &query, &context, visit_triangle, &state);
  return state.best;
}

std::optional<TriangleScene::Hit> TriangleScene::first_hit(const Vec3f& origin, const Vec3f& direction,
                                                           float limit) const {
  RTCRayHit ray{};
  ray.ray.org_x = origin.x;
  ray.ray.org_y = origin.y;
  ray.ray.org_z = origin.z;
  ray.ray.dir_x = direction.x;
  ray.ray.dir_y = direction.y;
  ray.ray.dir_z = direction.z;
  ray.ray.tfar = limit;
  ray.ray.mask = ~0u;
  ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(embree_->scene, &context, &ray);
  if (ray.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
  return Hit{ray.ray.tfar, ray.hit.primID};
}

}  // namespace b3dgs
