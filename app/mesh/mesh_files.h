// Writes triangle meshes as PLY, OBJ or glTF binary.
#pragma once

#include <filesystem>

#include "model/formats/triangle_mesh.h"
#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {

/// Checks that the extension is .ply, .obj or .glb, before long work whose result goes there. @throws InputError
void require_mesh_format(const std::filesystem::path& path);

/// Writes a mesh in the format of the extension, atomically. Positions are in `frame`, and the file has world
/// coordinates. The axes are those of the world in each format, although viewers of .glb take +y for up. @throws
/// InputError if the mesh is too large for the format; IoError
void write_mesh(const std::filesystem::path& path, const TriangleMesh& mesh, const CoordinateFrame& frame = {});

}  // namespace b3dgs
