// Writes triangle meshes as PLY, OBJ or glTF binary.
#pragma once

#include <array>
#include <filesystem>
#include <optional>

#include "model/formats/triangle_mesh.h"
#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {

/// Checks that the extension is .ply, .obj or .glb, before long work whose result goes there. @throws InputError
void require_mesh_format(const std::filesystem::path& path);

/// Writes a mesh in the format of the extension, atomically. Positions are in `frame`, and the file has world
/// coordinates. Viewers of .glb take +y for up, so the node of such a file turns `up`, a unit vector in world
/// coordinates, to +y. @throws InputError if the mesh is too large for the format; IoError
void write_mesh(const std::filesystem::path& path, const TriangleMesh& mesh, const CoordinateFrame& frame = {},
                const std::optional<std::array<double, 3>>& up = {});

}  // namespace b3dgs
