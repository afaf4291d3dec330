// One number per SIMD lane of a register. CasADi's C is compiled as C++ after this header, with
// casadi_real = lanes, a GCC vector of the register width, so that it evaluates a Function LANES
// times at once. Each lane computes the scalar operation and therefore has the same bits. Truth
// values are 1 or 0, as in CasADi. Without a conversion to bool, code that branches on a number
// does not compile.
#pragma once
#include <math.h>

#ifdef __AVX512F__
#define LANES 8
#elif defined __AVX__
#define LANES 4
#else
#define LANES 2
#endif  // Clang's __BIGGEST_ALIGNMENT__ is 16 on all processors

struct lanes {
  typedef double reals __attribute__((vector_size(8 * LANES)));
  typedef decltype(reals{} < reals{}) masks;
  reals v;

  lanes() = default;
  lanes(double x) : v(x - reals{}) {}
  lanes(reals x) : v(x) {}
  lanes(masks m) : v(m ? reals{} + 1 : reals{}) {}

  lanes operator-() const { return -v; }
  lanes operator!() const { return v == 0; }
  friend lanes operator+(lanes a, lanes b) { return a.v + b.v; }
  friend lanes operator-(lanes a, lanes b) { return a.v - b.v; }
  friend lanes operator*(lanes a, lanes b) { return a.v * b.v; }
  friend lanes operator/(lanes a, lanes b) { return a.v / b.v; }
  friend lanes operator<(lanes a, lanes b) { return a.v < b.v; }
  friend lanes operator>(lanes a, lanes b) { return a.v > b.v; }
  friend lanes operator<=(lanes a, lanes b) { return a.v <= b.v; }
  friend lanes operator>=(lanes a, lanes b) { return a.v >= b.v; }
  friend lanes operator==(lanes a, lanes b) { return a.v == b.v; }
  friend lanes operator!=(lanes a, lanes b) { return a.v != b.v; }
  friend lanes operator&(lanes a, lanes b) { return (a.v != 0) & (b.v != 0); }
  friend lanes operator|(lanes a, lanes b) { return (a.v != 0) | (b.v != 0); }
  friend lanes operator&&(lanes a, lanes b) { return a & b; }
  friend lanes operator||(lanes a, lanes b) { return a | b; }
  lanes& operator+=(lanes b) { return *this = *this + b; }
  lanes& operator-=(lanes b) { return *this = *this - b; }
  lanes& operator*=(lanes b) { return *this = *this * b; }
  lanes& operator/=(lanes b) { return *this = *this / b; }
};

static inline lanes select(lanes c, lanes a, lanes b) { return c.v != 0 ? a.v : b.v; }
static inline bool any(lanes c) {
  for (int i = 0; i < LANES; i++) if (c.v[i] != 0) return true;
  return false;
}

#define LANE_BY_LANE(...) { for (int i = 0; i < LANES; i++) a.v[i] = __VA_ARGS__; return a; }
#define OF_ONE(f) static inline lanes f(lanes a) LANE_BY_LANE(::f(a.v[i]))
#define OF_TWO(f) static inline lanes f(lanes a, lanes b) LANE_BY_LANE(::f(a.v[i], b.v[i]))
OF_ONE(sin) OF_ONE(cos) OF_ONE(tan) OF_ONE(asin) OF_ONE(acos) OF_ONE(atan) OF_ONE(sqrt)
OF_ONE(sinh) OF_ONE(cosh) OF_ONE(tanh) OF_ONE(exp) OF_ONE(log) OF_ONE(expm1) OF_ONE(log1p)
OF_ONE(asinh) OF_ONE(acosh) OF_ONE(atanh) OF_ONE(erf) OF_ONE(ceil)
OF_TWO(atan2) OF_TWO(pow) OF_TWO(fmod) OF_TWO(remainder) OF_TWO(hypot) OF_TWO(copysign)

static inline lanes sign(lanes x) { return select(x < 0.0, -1.0, select(x > 0.0, 1.0, x)); }

struct complex { lanes real, imaginary; };
#define REAL lanes
#define SELECT select
#define ANY any
#define PAIR complex
#define TO_PAIR(real, imaginary) complex{real, imaginary}
#define REAL_PART(pair) (pair).real
#define IMAGINARY_PART(pair) (pair).imaginary
#include "elementary.h"

// Function.if_else. If lanes disagree, both Functions run and each lane selects its results. So a
// search continues until it has ended in all lanes. lengths: lengths of the results.
typedef int function(const lanes**, lanes**, long long*, lanes*, int);
template <int... lengths> static int if_else(function yes, function no, const lanes** arg,
                                             lanes** res, long long* iw, lanes* w) {
  lanes otherwise = fabs(*arg[0]) < 1.0;  // as C converts it to an integer
  if (!any(otherwise)) return yes(arg + 1, res, iw, w, 0);
  if (!any(!otherwise)) return no(arg + 1, res, iw, w, 0);
  lanes yes_results[(lengths + ...)], *saved = yes_results;
  const int n_out = sizeof...(lengths), n[] = {lengths...};
  if (yes(arg + 1, res, iw, w, 0)) return 1;
  for (int k = 0; k < n_out; saved += n[k++])
    for (int i = 0; res[k] && i < n[k]; i++) saved[i] = res[k][i];
  if (no(arg + 1, res, iw, w, 0)) return 1;
  saved = yes_results;
  for (int k = 0; k < n_out; saved += n[k++])
    for (int i = 0; res[k] && i < n[k]; i++) res[k][i] = select(otherwise, res[k][i], saved[i]);
  return 0;
}

// Bilinear interpolation, one table per lane, as in casadi_interpn: m values at the points 0, 1, 2 …
// of two dimensions.
static void bilinear(lanes* res, int, const lanes*, const long long* offset, const lanes* values,
                     const lanes* x, const long long*, int m, long long*, lanes*) {
  long long n = offset[1] - offset[0], last[] = {n - 1, offset[2] - offset[1] - 1}, at[2];
  double share[2];
  for (int k = 0; k < m; k++) res[k] = 0.0;
  for (int lane = 0; lane < LANES; lane++) {
    for (int d = 0; d < 2; d++) {
      at[d] = (long long)(x[d].v[lane] * last[d] / last[d]);
      at[d] = at[d] < 0 ? 0 : at[d] < last[d] ? at[d] : last[d] - 1;
      share[d] = x[d].v[lane] - at[d];
    }
    for (int corner = 0; corner < 4; corner++) {
      int i = corner & 1, j = corner >> 1;
      double weight = (i ? share[0] : 1 - share[0]) * (j ? share[1] : 1 - share[1]);
      const lanes* value = values + (at[0] + i + (at[1] + j) * n) * m;
      for (int k = 0; k < m; k++) res[k].v[lane] += weight * value[k].v[lane];
    }
  }
}
