// The surfaces of synthetic scenes as triangle meshes, to measure reconstructed surfaces against.
#pragma once

#include "core/vec.h"
#include "model/formats/triangle_mesh.h"

namespace b3dgs {

// The solids of `orbit`, in world units. +z is up, and the ground is at z = 0.
inline constexpr double kGroundRadius = 2.6;
inline constexpr Vec3<double> kBallCenter{-0.9, -0.5, 0.6};
inline constexpr double kBallRadius = 0.6;
inline constexpr double kBoxHalf = 0.42;  // half the side
inline constexpr Vec3<double> kBoxCenter{0.85, -0.45, kBoxHalf};
inline constexpr double kRingMajor = 0.55, kRingMinor = 0.2;
inline constexpr Vec3<double> kRingCenter{0.15, 0.95, kRingMinor};

// Each function appends triangles whose normals point out of the solid, or up. Curved surfaces deviate from the exact
// ones by less than 3e-4 of their radius.

/// A disc in the plane z = center.z.
void append_disc(const Vec3<double>& center, double radius, TriangleMesh& mesh);
void append_ball(const Vec3<double>& center, double radius, TriangleMesh& mesh);
/// An axis-aligned box with sides 2 half. A box that stands on the ground has no bottom.
void append_box(const Vec3<double>& center, const Vec3<double>& half, bool has_bottom, TriangleMesh& mesh);
/// A torus about the z axis.
void append_ring(const Vec3<double>& center, double major, double minor, TriangleMesh& mesh);

/// Returns the surface of `orbit`.
TriangleMesh orbit_truth_mesh();

}  // namespace b3dgs
