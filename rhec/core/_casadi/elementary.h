/* Elementary functions by the same few operations for one number (C) and for lanes of them (C++,
   lanes.h), so that both have the same bits. Included before the C that CasADi generates. */
#include <math.h>
#ifndef REAL
#define REAL double
#define SELECT(condition, yes, no) ((condition) ? (yes) : (no))
#define ANY(condition) (condition)
#define PAIR _Complex double
#define TO_PAIR(real, imaginary) __builtin_complex(real, imaginary)
#define REAL_PART(pair) __real__(pair)
#define IMAGINARY_PART(pair) __imag__(pair)
#endif

static inline REAL own_fmin(REAL x, REAL y) { return SELECT((x < y) | (y != y), x, y); }
static inline REAL own_fmax(REAL x, REAL y) { return SELECT((x > y) | (y != y), x, y); }
static inline REAL own_fabs(REAL x) { return SELECT(x > 0.0, x, 0.0 - x); }

/* The nearest whole number: a sum so large has no room for a fraction. */
#define WHOLE(x) (((x) + 6755399441055744.0) - 6755399441055744.0)
static inline REAL own_floor(REAL x) {
  REAL whole = WHOLE(x);
  return SELECT(own_fabs(x) < 0x1p51, SELECT(whole > x, whole - 1.0, whole), x);
}

/* cos x + i sin x, within two units in the last place up to a million radians; the C library's
   beyond. Less n quarter turns, in three parts, the angle lies within pi/4, where Taylor's series
   are good to the last digit; q = n modulo 4, between -2 and 2, turns them back. One value, so
   that the compiler calls it once for the sine and the cosine of an angle. */
__attribute__((const, noinline)) static PAIR own_cis(REAL x) {
  REAL n = WHOLE(x * 0x1.45f306dc9c883p-1), q = n - 4.0 * WHOLE(n * 0.25);
  REAL first = x - n * 0x1.921fb544p+0, second = n * 0x1.0b4611a6p-34, rest = first - second;
  REAL r = rest - (n * 0x1.3198a2e037073p-69 - ((first - rest) - second)), z = r * r;
  REAL s = z * (1. / 6227020800 - z * (1. / 1307674368000));
  s = z * (1. / 362880 + z * (-1. / 39916800 + s));
  s = r + r * (z * (-1. / 6 + z * (1. / 120 + z * (-1. / 5040 + s))));
  REAL c = z * (-1. / 87178291200 + z * (1. / 20922789888000));
  c = z * (1. / 40320 + z * (-1. / 3628800 + z * (1. / 479001600 + c)));
  c = 1.0 - (0.5 * z - z * z * (1. / 24 + z * (-1. / 720 + c)));
  REAL odd = q * q, turned_c = SELECT(odd == 1.0, s, c), turned_s = SELECT(odd == 1.0, c, s);
  PAIR pair = TO_PAIR(SELECT((q == 1.0) | (odd == 4.0), 0.0 - turned_c, turned_c),
                      SELECT((q == -1.0) | (odd == 4.0), 0.0 - turned_s, turned_s));
  REAL far = !(own_fabs(x) < 1e6);
  if (ANY(far))
    return TO_PAIR(SELECT(far, cos(x), REAL_PART(pair)), SELECT(far, sin(x), IMAGINARY_PART(pair)));
  return pair;
}
static inline REAL own_sin(REAL x) { return IMAGINARY_PART(own_cis(x)); }
static inline REAL own_cos(REAL x) { return REAL_PART(own_cis(x)); }

/* The angle of (x, y), within three units in the last place; the C library's where y is zero or
   one is huge or not a number. That of the greater coordinate and the lesser lies within pi/4; less
   pi/4 where it is beyond pi/8, Taylor's series is good to the last digit. */
static REAL own_atan2(REAL y, REAL x) {
  REAL width = own_fabs(x), height = own_fabs(y);
  REAL less = own_fmin(width, height), more = own_fmax(width, height);
  REAL beyond = less > 0x1.a827999fcef32p-2 * more;
  REAL r = SELECT(beyond, less - more, less) / SELECT(beyond, less + more, more), z = r * r;
  REAL series = 0.0, eighth_turn = 0x1.921fb54442d18p-1;
  for (int k = 19; k > 0; k--) series = z * (1.0 / (2 * k + 1) - series);
  REAL angle = r - r * series;
  angle = SELECT(beyond, eighth_turn + angle, angle);
  angle = SELECT(height > width, 2.0 * eighth_turn - angle, angle);
  angle = SELECT(x < 0.0, 4.0 * eighth_turn - angle, angle);
  angle = SELECT(y < 0.0, 0.0 - angle, angle);
  REAL strange = !((height > 0.0) & (width >= 0.0) & (more < 1e300));
  return ANY(strange) ? SELECT(strange, atan2(y, x), angle) : angle;
}

/* 2^k for a whole k within 600: the product of the powers that the binary digits of |k| name. */
static inline REAL power_of_two(REAL k) {
  static const double powers[] = {0x1p512, 0x1p256, 0x1p128, 0x1p64, 0x1p32,
                                  0x1p16,  0x1p8,   0x1p4,   0x1p2,  0x1p1};
  REAL left = own_fabs(k), product = 1.0;
  for (int place = 0; place < 10; place++) {
    double digit = 512 >> place;
    REAL has = left >= digit;
    product = SELECT(has, product * powers[place], product);
    left = SELECT(has, left - digit, left);
  }
  return SELECT(k < 0.0, 1.0 / product, product);
}

/* e^x within one unit in the last place; 0 and infinity where no number is near. x = k ln 2 + r
   with ln 2 in two parts and r within ln 2 / 2, where Taylor's series is good to the last digit. */
static REAL own_exp(REAL x) {
  REAL inside = own_fmax(own_fmin(x, 710.0), -750.0);
  REAL k = WHOLE(inside * 0x1.71547652b82fep+0), half = WHOLE(k * 0.5);
  REAL first = inside - k * 0x1.62e42feep-1, second = k * 0x1.a39ef35793c76p-33;
  REAL r = first - second, rest = (first - r) - second, series = 0.0;
  static const double inverse_factorials[] = {
      1. / 6227020800, 1. / 479001600, 1. / 39916800, 1. / 3628800, 1. / 362880, 1. / 40320,
      1. / 5040,       1. / 720,       1. / 120,      1. / 24,      1. / 6,      1. / 2};
  for (int n = 0; n < 12; n++) series = inverse_factorials[n] + r * series;
  REAL power = (1.0 + (r + (rest + r * r * series))) * power_of_two(half) * power_of_two(k - half);
  return SELECT(x != x, x, power);
}

#define sin own_sin
#define cos own_cos
#define atan2 own_atan2
#define fmin own_fmin
#define fmax own_fmax
#define fabs own_fabs
#define floor own_floor
#define exp own_exp
