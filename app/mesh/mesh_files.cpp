#include "app/mesh/mesh_files.h"

#include <tiny_gltf.h>

#include <algorithm>
#include <array>
#include <string>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/text.h"
#include "model/edit/edit.h"
#include "scene/cameras/camera.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

using Up = std::optional<std::array<double, 3>>;
using WriteMesh = void (*)(const fs::path&, const TriangleMesh&, const CoordinateFrame&, const Up&);

constexpr std::size_t kMaxGlbBytes = 0xFFFFFFFF;  // the length of the file is stored in 32 bits
constexpr std::size_t kGlbReserve = 1 << 16;      // for the JSON part and headers

void write_mesh_obj(const fs::path& path, const TriangleMesh& mesh, const CoordinateFrame& frame, const Up& /*up*/) {
  constexpr std::size_t kBytesPerWrite = 1 << 20;
  AtomicFile file(path);
  std::string text = "# b3dgs\n";
  const auto flush = [&](std::size_t at_least) {
    if (text.size() < at_least) return;
    file.write(text);
    text.clear();
  };
  const int digits = frame.is_far() ? 16 : 9;
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const std::array<double, 3> p = frame.to_world(&mesh.positions[i].x);
    text += print_to_string("v %.*g %.*g %.*g", digits, p[0], digits, p[1], digits, p[2]);
    if (!mesh.colors.empty()) {  // an extension that most programs read
      const TriangleMesh::Color& c = mesh.colors[i];
      text += print_to_string(" %.4f %.4f %.4f", c[0] / 255.0, c[1] / 255.0, c[2] / 255.0);
    }
    text += "\n";
    flush(kBytesPerWrite);
  }
  for (const Vec3f& n : mesh.normals) {
    text += print_to_string("vn %.5f %.5f %.5f\n", n.x, n.y, n.z);
    flush(kBytesPerWrite);
  }
  for (const TriangleMesh::Triangle& t : mesh.triangles) {
    text += "f";
    for (const std::uint32_t vertex : t) {
      const std::string number = std::to_string(std::uint64_t{vertex} + 1);
      text += " " + number;
      if (!mesh.normals.empty()) text += "//" + number;
    }
    text += "\n";
    flush(kBytesPerWrite);
  }
  flush(1);
  file.commit();
}

/// Appends values to the buffer of the model, and returns the index of their accessor.
template <class Value>
int add_accessor(tinygltf::Model& model, const std::vector<Value>& values, int target, int component, int type,
                 std::size_t count) {
  std::vector<unsigned char>& data = model.buffers[0].data;
  const auto* const bytes = reinterpret_cast<const unsigned char*>(values.data());
  tinygltf::BufferView view;
  view.buffer = 0;
  view.byteOffset = data.size();
  view.byteLength = sizeof(Value) * values.size();
  view.target = target;
  data.insert(data.end(), bytes, bytes + view.byteLength);
  tinygltf::Accessor accessor;
  accessor.bufferView = static_cast<int>(model.bufferViews.size());
  accessor.componentType = component;
  accessor.type = type;
  accessor.count = count;
  accessor.normalized = component == TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE;
  model.bufferViews.push_back(view);
  model.accessors.push_back(accessor);
  return static_cast<int>(model.accessors.size()) - 1;
}

void require_glb_size(const fs::path& path, const TriangleMesh& mesh) {
  const std::size_t per_vertex = 12 + (mesh.normals.empty() ? 0 : 12) + (mesh.colors.empty() ? 0 : 4);
  const std::size_t bytes = per_vertex * mesh.positions.size() + 12 * mesh.triangles.size() + kGlbReserve;
  if (bytes <= kMaxGlbBytes) return;
  input_error(path.string(), ": a .glb has at most ", format_bytes(kMaxGlbBytes), ", and ",
              format_count(static_cast<std::int64_t>(mesh.triangles.size())), " triangles need ", format_bytes(bytes),
              "; use --faces ", mesh.triangles.size() / (bytes / kMaxGlbBytes + 1), ", or write a .ply");
}

void write_mesh_glb(const fs::path& path, const TriangleMesh& mesh, const CoordinateFrame& frame, const Up& up) {
  require_glb_size(path, mesh);
  // Positions are in single precision. If that is too coarse, the node has the origin of the frame.
  std::vector<Vec3f> positions;
  std::array<double, 3> low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};
  const CoordinateFrame local{frame.is_far() ? std::array<double, 3>{} : frame.origin, frame.unit};
  for (const Vec3f& position : mesh.positions) {
    const std::array<double, 3> p = local.to_world(&position.x);
    const std::array<float, 3> stored{static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
    positions.push_back({stored[0], stored[1], stored[2]});
    for (std::size_t axis = 0; axis < 3; ++axis) {
      low[axis] = std::min<double>(low[axis], stored[axis]);
      high[axis] = std::max<double>(high[axis], stored[axis]);
    }
  }

  tinygltf::Model model;
  model.asset.version = "2.0";
  model.asset.generator = "b3dgs";
  model.buffers.resize(1);
  tinygltf::Primitive primitive;
  primitive.mode = TINYGLTF_MODE_TRIANGLES;
  const std::size_t n = positions.size();
  const auto add_attribute = [&](const char* name, const auto& values, int component, int type) {
    primitive.attributes[name] = add_accessor(model, values, TINYGLTF_TARGET_ARRAY_BUFFER, component, type, n);
  };
  add_attribute("POSITION", positions, TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC3);
  model.accessors[0].minValues.assign(low.begin(), low.end());
  model.accessors[0].maxValues.assign(high.begin(), high.end());
  if (!mesh.normals.empty()) {
    add_attribute("NORMAL", mesh.normals, TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC3);
  }
  if (!mesh.colors.empty()) {  // four bytes, because attributes are aligned to four
    std::vector<std::array<std::uint8_t, 4>> colors;
    for (const TriangleMesh::Color& c : mesh.colors) colors.push_back({c[0], c[1], c[2], 255});
    add_attribute("COLOR_0", colors, TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE, TINYGLTF_TYPE_VEC4);
  }
  primitive.indices =
      add_accessor(model, mesh.triangles, TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER, TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT,
                   TINYGLTF_TYPE_SCALAR, 3 * mesh.triangles.size());
  model.meshes.resize(1);
  model.meshes[0].primitives.push_back(primitive);
  model.nodes.resize(1);
  model.nodes[0].mesh = 0;
  const UnitQuat turn = up ? rotation_between(*up, {0, 1, 0}) : UnitQuat{1, 0, 0, 0};
  if (up) model.nodes[0].rotation = {turn[1], turn[2], turn[3], turn[0]};
  if (frame.is_far()) {
    const std::array<double, 3> origin = rotated(rotation_from_quaternion(turn), frame.origin);
    model.nodes[0].translation.assign(origin.begin(), origin.end());
  }
  model.scenes.resize(1);
  model.scenes[0].nodes.push_back(0);
  model.defaultScene = 0;

  AtomicFile file(path);
  if (!tinygltf::TinyGLTF().WriteGltfSceneToFile(&model, file.temporary().string(), true, true, false, true)) {
    io_error("cannot write ", path.string(), "; check that the disk is not full");
  }
  file.commit();
}

WriteMesh writer_of(const fs::path& path) {
  const std::string extension = lower_case(path.extension().string());
  if (extension == ".ply") {
    return [](const fs::path& file, const TriangleMesh& mesh, const CoordinateFrame& frame, const Up& /*up*/) {
      write_mesh_ply(file, mesh, frame);
    };
  }
  if (extension == ".obj") return write_mesh_obj;
  if (extension == ".glb") return write_mesh_glb;
  input_error(path.string(), ": expected a file name that ends in .ply, .obj or .glb, found \"", extension, "\"");
}

}  // namespace

void require_mesh_format(const fs::path& path) {
  writer_of(path);
}

void write_mesh(const fs::path& path, const TriangleMesh& mesh, const CoordinateFrame& frame,
                const std::optional<std::array<double, 3>>& up) {
  writer_of(path)(path, mesh, frame, up);
}

}  // namespace b3dgs
