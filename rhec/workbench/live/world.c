/* What rhec.simulate makes of a seed, every bit, for the live page: noise and soil.

   The noise is NumPy's: its counter-based generator Philox 4x64 with ten rounds (Salmon et al.
   2011), then the ziggurat of Marsaglia and Tsang. The tables that both need stand before this
   text; what is shared with the page begins with `at_`. */
#include <math.h>

typedef unsigned long long u64;
static u64 key[2], counter, buffer[4];
static int used;

static u64 philox(void) {
  if (used == 4) {
    u64 c[4] = {++counter, 0, 0, 0}, k[2] = {key[0], key[1]};
    for (int round = 0; round < 10; round++) {
      unsigned __int128 p = (unsigned __int128)0xD2E7470EE14C6C93ull * c[0];
      unsigned __int128 q = (unsigned __int128)0xCA5A826395121157ull * c[2];
      c[0] = (u64)(q >> 64) ^ c[1] ^ k[0];
      c[2] = (u64)(p >> 64) ^ c[3] ^ k[1];
      c[1] = (u64)q;
      c[3] = (u64)p;
      k[0] += 0x9E3779B97F4A7C15ull;
      k[1] += 0xBB67AE8584CAA73Bull;
    }
    for (int i = 0; i < 4; i++) buffer[i] = c[i];
    used = 0;
  }
  return buffer[used++];
}

static double uniform(void) { return (double)(philox() >> 11) * 0x1p-53; }

static double normal(void) {
  for (;;) {
    u64 bits = philox(), layer = bits & 255, size = (bits >> 9) & 0x000fffffffffffffull;
    double x = (double)size * width[layer];
    if (bits & 256) x = -x;
    if (size < inner[layer]) return x;
    if (!layer)
      for (double end = width[255] * 0x1p52;;) {  /* beyond the last layer */
        double beyond = -0.27366123732975827203338247596 * log1p(-uniform());
        double y = -log1p(-uniform());
        if (y + y > beyond * beyond) return (size >> 8) & 1 ? -(end + beyond) : end + beyond;
      }
    if ((height[layer - 1] - height[layer]) * uniform() + height[layer] < exp(-0.5 * x * x))
      return x;
  }
}

/* rhec.simulation.closed_loop.draw_noise of a seed, into rows of at_stream that are `wide` long. */
void noise(int seed, int wide) {
  for (int stream = 0; stream < 2; stream++) {
    int from = stream ? NOISE - 1 : 0, to = stream ? NOISE : NOISE - 1;
    key[0] = keys[seed][stream][0], key[1] = keys[seed][stream][1], counter = 0, used = 4;
    for (int k = 0; k < MOST; k++)
      for (int i = from; i < to; i++) at_stream[k * wide + i] = normal();
  }
}

/* numpy.interp between the quantiles, within the limits of traction. */
static double traction(double gaussian, const double *table) {
  int low = 0, high = QUANTILES - 1;
  double value = gaussian < quantiles[0] ? table[0] : table[high];
  if (gaussian >= quantiles[0] && gaussian < quantiles[high]) {
    while (high - low > 1) {
      int middle = (low + high) / 2;
      if (quantiles[middle] <= gaussian) low = middle;
      else high = middle;
    }
    double slope = (table[high] - table[low]) / (quantiles[high] - quantiles[low]);
    value = slope * (gaussian - quantiles[low]) + table[low];
  }
  return value < LOWEST ? LOWEST : value > 1 ? 1 : value;
}

/* The field of rhec.tracked_robot.terrain.random_for, laid out as `flat` does on the loop's grid.

   It goes into at_slip, its corner into at_origin_m, its points into at_n; at_patches has
   (x, y, radius, mu, kappa) of each patch. */
void soil(int seed, int kind, double start_offset_m, int n_patches) {
  double margin = MARGIN_M + fabs(start_offset_m);
  for (int axis = 0; axis < 2; axis++) {
    at_origin_m[axis] = lowest[axis] - margin;
    at_n[axis] = (int)ceil((highest[axis] + margin - at_origin_m[axis]) / CELL_M) + 1;
  }
  for (int field = 0; field < 2; field++)
    for (int j = 0; j < LONG; j++)
      for (int i = 0; i < WIDE; i++) {
        int row = i < at_n[0] ? i : at_n[0] - 1, column = j < at_n[1] ? j : at_n[1] - 1;
        double *here = &at_slip[field + 2 * (i + WIDE * j)];
        *here = traction(windows[seed][field][row][column], soils[kind][field]);
        for (const double *p = at_patches; p < at_patches + 5 * n_patches; p += 5) {
          double dx = at_origin_m[0] + CELL_M * row - p[0];
          double dy = at_origin_m[1] + CELL_M * column - p[1];
          if (dx * dx + dy * dy <= p[2] * p[2]) *here = p[3 + field];
        }
      }
}
