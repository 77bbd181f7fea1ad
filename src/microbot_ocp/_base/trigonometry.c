/* Sine and cosine of a REAL (double or vector), which the compiler can inline. The C library takes
   11 ns for both, for one number at a time.

   The argument is x = r + n pi/2 with |r| <= pi/4. pi/2 is a sum of three parts (Cody and Waite),
   the first two of 33 bits, so that their products with n are exact up to FAR. The polynomials are
   those of k_sin.c and k_cos.c in fdlibm. The error is below three units in the last place; beyond
   FAR the C library is called. */

#include <math.h>

#define FAR 1e6
#define NEAREST(x) (((x) + 6755399441055744.) - 6755399441055744.) /* 1.5 * 2^52: sums round to integers */
#define WHERE_double(condition, a, b) ((condition) ? (a) : (b))
#define WHERE_vector(condition, a, b) WHERE(condition, a, b)

static inline void reduce_REAL(REAL x, REAL *r, REAL *quarter) {
  const REAL n = NEAREST(x * 0.63661977236758134308);
  *r = ((x - n * 1.57079632673412561417) - n * 6.07710050630396597660e-11)
       - n * 2.02226624879595063154e-21;
  *quarter = n - 4. * NEAREST(n * 0.25); /* -2, -1, 0, 1 or 2 */
}

static inline REAL small_sine_REAL(REAL r) {
  const REAL z = r * r;
  return r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03
         + z * (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06
         + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
}

static inline REAL small_cosine_REAL(REAL r) {
  const REAL z = r * r;
  return (1. - 0.5 * z) + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03
         + z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07
         + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
}

static inline REAL sine_REAL(REAL x) {
  REAL r, quarter, y;
  reduce_REAL(x, &r, &quarter);
  y = WHERE_REAL(quarter * quarter == 1., small_cosine_REAL(r), small_sine_REAL(r));
  return WHERE_REAL((quarter == -1.) | (quarter * quarter == 4.), -y, y);
}

static inline REAL cosine_REAL(REAL x) {
  REAL r, quarter, y;
  reduce_REAL(x, &r, &quarter);
  y = WHERE_REAL(quarter * quarter == 1., small_sine_REAL(r), small_cosine_REAL(r));
  return WHERE_REAL((quarter == 1.) | (quarter * quarter == 4.), -y, y);
}

/* Names for CasADi's code of one state, and for the operations on vectors of states. */
#define IS_double 1
#if IS_REAL
static inline double sine(double x) {
  const double y = sine_double(x);
  return fabs(x) > FAR ? sin(x) : y;
}

static inline double cosine(double x) {
  const double y = cosine_double(x);
  return fabs(x) > FAR ? cos(x) : y;
}

#define sin(x) sine(x)
#define cos(x) cosine(x)
#else
#define SINE(x) (far |= (mask)(MAGNITUDE(x) > FAR), sine_vector(x))
#define COSINE(x) (far |= (mask)(MAGNITUDE(x) > FAR), cosine_vector(x))
#endif
