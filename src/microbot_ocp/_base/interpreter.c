/* An interpreter of operation tables for blocks of columns. interpreter.py inserts a case for each
   operation; or it defines TABLES and appends tables, which are linked to the interpreter. In the
   work array the columns of one place are adjacent; inputs and outputs are stored column after
   column, as in CasADi. Tables are string literals, which a compiler reads ten times as fast as
   lists of numbers. */

#include <math.h>
#include <stddef.h>

typedef long long int casadi_int;
typedef struct { unsigned short operation, to, of, and; } __attribute__((may_alias)) Operation;
typedef void Interpreter(
    const Operation* code, const Operation* end, const double* constants, const int* in,
    const int* out, const double** arg, double** res, double* work);
__attribute__((visibility("hidden"))) Interpreter interpret_1, interpret_block;

/* Loads that cross a cache line take twice as long, so blocks begin at one. */
#define ALIGNED(work) \
  ((double*) (((size_t) (work) + ALIGNMENT * sizeof(double) - 1) & -(ALIGNMENT * sizeof(double))))

#ifndef TABLES
#define TRUTH(condition) ((condition) ? 1. : 0.)
#define WHERE(condition, a, b) ((condition) ? (a) : (b))
#define NOTHING 0.
#define MAGNITUDE(a) fabs(a)
#define EACH(f, a) f(a)
#define EACH_PAIR(f, a, b) f(a, b)
#define SINE(a) sin(a)
#define COSINE(a) cos(a)

#define AT(place) (work + (long) columns * (place))
#define EVERY(column) for (int column = 0; column < columns; column++)
#define CASE(operation, formula) \
  case operation: { \
    const double *a = AT(code->of), *b = AT(code->and); \
    EVERY(j) { const double x = a[j], y = b[j]; to[j] = formula; } \
    break; \
  }

/* Two rows of the table: operands of the first product, then those of a second product or the other
   operand. The product is rounded before the sum, as in separate operations. */
#define WITH_PRODUCTS(operation, formula) \
  case operation: { \
    const double *a = AT(code->of), *b = AT(code->and); \
    const double *c = AT(code[1].of), *d = AT(code[1].and); \
    EVERY(j) { const double x = a[j] * b[j], y = c[j], z = d[j]; to[j] = formula; } \
    code++; \
    break; \
  }

static inline __attribute__((always_inline)) void interpret(
    const int columns, const Operation* code, const Operation* end, const double* constants,
    const int* in, const int* out, const double** arg, double** res, double* work) {
  for (; code < end; code++) {
    double* to = AT(code->to);
    switch (code->operation) {
      case MOVE_CONST:
        EVERY(j) to[j] = constants[code->of];
        break;
      case MOVE_INPUT: {
        const double* x = arg[code->of];
        EVERY(j) to[j] = x ? x[(long) j * in[code->of] + code->and] : 0.;
        break;
      }
      case MOVE_OUTPUT: {
        double* y = res[code->of];
        if (y) EVERY(j) y[(long) j * out[code->of] + code->and] = to[j];
        break;
      }
      WITH_PRODUCTS(PRODUCT_PLUS, x + y)
      WITH_PRODUCTS(PRODUCT_MINUS, x - y)
      WITH_PRODUCTS(MINUS_PRODUCT, y - x)
      WITH_PRODUCTS(SUM_OF_PRODUCTS, x + y * z)
      WITH_PRODUCTS(DIFFERENCE_OF_PRODUCTS, x - y * z)
      /* further cases */
    }
  }
}

#define INTERPRETER(name, columns) \
  __attribute__((noinline)) void name( \
      const Operation* code, const Operation* end, const double* constants, const int* in, \
      const int* out, const double** arg, double** res, double* work) { \
    interpret(columns, code, end, constants, in, out, arg, res, work); \
  }

INTERPRETER(interpret_1, 1)
INTERPRETER(interpret_block, COLUMNS)

/* Evaluates rows of numpy arrays, a multiple of COLUMNS, block by block. The pointers end as they
   began, so that the same memory is evaluated again. */
void interpret_rows(
    long rows, const Operation* code, const Operation* end, const double* constants, long inputs,
    const int* in, long outputs, const int* out, const double** arg, double** res, double* work) {
  for (long row = 0; row < rows; row += COLUMNS) {
    interpret_block(code, end, constants, in, out, arg, res, ALIGNED(work));
    for (long k = 0; k < inputs; k++) arg[k] += (long) COLUMNS * in[k];
    for (long k = 0; k < outputs; k++) res[k] += (long) COLUMNS * out[k];
  }
  for (long k = 0; k < inputs; k++) arg[k] -= rows * in[k];
  for (long k = 0; k < outputs; k++) res[k] -= rows * out[k];
}

#else

#define SPARSITY(name, side, count, ...) \
  casadi_int name##_n_##side(void) { return count; } \
  const casadi_int* name##_sparsity_##side(casadi_int k) { \
    static const casadi_int* const all[] = {__VA_ARGS__}; \
    return all[k]; \
  }

#define FUNCTION(table, name, columns, inputs, outputs, places) \
  int name(const double** arg, double** res, casadi_int* iw, double* w, int mem) { \
    int end = 0; /* after the last operation of the requested outputs */ \
    for (int k = 0; k < outputs; k++) \
      if (res[k] && table##_ends[k] > end) end = table##_ends[k]; \
    (columns == 1 ? interpret_1 : interpret_block)( \
        (const Operation*) table##_code, (const Operation*) table##_code + end, table##_constants, table##_in, table##_out, arg, res, ALIGNED(w)); \
    return 0; \
  } \
  int name##_work(casadi_int* arg, casadi_int* res, casadi_int* iw, casadi_int* w) { \
    *arg = inputs, *res = outputs, *iw = 0, *w = (casadi_int) columns * places + ALIGNMENT; \
    return 0; \
  }

#endif
