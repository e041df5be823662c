// Shared by host and device code: pi, small vectors and matrices with the operators that the project needs, and
// declarations.
#pragma once

#if defined(__CUDACC__)
#define B3DGS_HD __host__ __device__ __forceinline__
#else
#define B3DGS_HD inline
#endif

// As in CUDA's headers, so that builds without CUDA can declare the functions of its kernels.
struct CUstream_st;
using cudaStream_t = CUstream_st*;

namespace b3dgs {

inline constexpr double kPi = 3.14159265358979323846;
inline constexpr double kDegree = kPi / 180;  // rad

template <class Real>
struct Vec2 {
  Real x, y;
};

template <class Real>
struct Vec3 {
  Real x, y, z;
};

template <class Real>
struct Vec4 {
  Real x, y, z, w;
};

/// Row-major.
template <class Real>
struct Mat3 {
  Real m[9];
  B3DGS_HD Real operator()(int row, int column) const { return m[3 * row + column]; }
  B3DGS_HD Real& operator()(int row, int column) { return m[3 * row + column]; }
};

/// Symmetric 2 x 2.
template <class Real>
struct Sym2 {
  Real xx, xy, yy;
};

using Vec2f = Vec2<float>;
using Vec3f = Vec3<float>;
using Vec4f = Vec4<float>;
using Mat3f = Mat3<float>;
using Sym2f = Sym2<float>;

template <class Real>
B3DGS_HD Vec3<Real> operator+(Vec3<Real> a, Vec3<Real> b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}

template <class Real>
B3DGS_HD Vec3<Real> operator-(Vec3<Real> a, Vec3<Real> b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}

template <class Real>
B3DGS_HD Vec3<Real> operator*(Real s, Vec3<Real> a) {
  return {s * a.x, s * a.y, s * a.z};
}

template <class Real>
B3DGS_HD Real dot(Vec3<Real> a, Vec3<Real> b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

template <class Real>
B3DGS_HD Vec3<Real> cross(Vec3<Real> a, Vec3<Real> b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class Real>
B3DGS_HD Vec3<Real> operator*(const Mat3<Real>& a, Vec3<Real> v) {
  return {a.m[0] * v.x + a.m[1] * v.y + a.m[2] * v.z, a.m[3] * v.x + a.m[4] * v.y + a.m[5] * v.z,
          a.m[6] * v.x + a.m[7] * v.y + a.m[8] * v.z};
}

/// transpose(a) * v
template <class Real>
B3DGS_HD Vec3<Real> transpose_times(const Mat3<Real>& a, Vec3<Real> v) {
  return {a.m[0] * v.x + a.m[3] * v.y + a.m[6] * v.z, a.m[1] * v.x + a.m[4] * v.y + a.m[7] * v.z,
          a.m[2] * v.x + a.m[5] * v.y + a.m[8] * v.z};
}

}  // namespace b3dgs
