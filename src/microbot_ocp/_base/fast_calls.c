/* Template of a Python module around CasADi's C code of one function, which precedes it.

   fast_calls.py replaces the names between at signs by sizes and code. The work arrays may be
   static because Python's interpreter lock is held from the first to the last row. */
#define PY_SSIZE_T_CLEAN
#define NPY_NO_DEPRECATED_API NPY_1_7_API_VERSION
#include <Python.h>
#include <numpy/arrayobject.h>
#include <string.h>

static const npy_intp in_size[] = {@IN_SIZE@};
static const char *const in_name[] = {@IN_NAME@};
static const npy_intp out_rows[] = {@OUT_ROWS@};
static const npy_intp out_columns[] = {@OUT_COLUMNS@};
static PyObject *input_error;
static int memory;

/* Evaluates one state; a repeated function continues while its second output is positive. */
static int evaluate(const double **arg, double **res, casadi_int *iw, double *w) {
#if @MOST@ && !@KEPT@
  static double state[@STATE@];
  int k;
  memcpy(state, arg[0], sizeof state);
  arg[0] = state;
  for (k = 0; k < @MOST@; ++k) {
    if (@NAME@(arg, res, iw, w, memory)) return 1;
    if (!(res[1][0] > 0)) break;
    memcpy(state, res[0], sizeof state);
  }
  return 0;
#else
  return @NAME@(arg, res, iw, w, memory);
#endif
}

#if @HAS_WIDE@
/* A vector register holds LANES states, one in each lane. The order of operations is that of a
   single state, so the results have equal bits. */
#if defined(__AVX512F__)
#define LANES 8
#define EACH(f, a) ((vector){f(a[0]), f(a[1]), f(a[2]), f(a[3]), f(a[4]), f(a[5]), f(a[6]), f(a[7])})
#define EACH_PAIR(f, a, b) ((vector){f(a[0], b[0]), f(a[1], b[1]), f(a[2], b[2]), f(a[3], b[3]), \
                                     f(a[4], b[4]), f(a[5], b[5]), f(a[6], b[6]), f(a[7], b[7])})
#elif defined(__AVX__)
#define LANES 4
#define EACH(f, a) ((vector){f(a[0]), f(a[1]), f(a[2]), f(a[3])})
#define EACH_PAIR(f, a, b) ((vector){f(a[0], b[0]), f(a[1], b[1]), f(a[2], b[2]), f(a[3], b[3])})
#else
#define LANES 2
#define EACH(f, a) ((vector){f(a[0]), f(a[1])})
#define EACH_PAIR(f, a, b) ((vector){f(a[0], b[0]), f(a[1], b[1])})
#endif
typedef double vector __attribute__((vector_size(8 * LANES)));
typedef long long mask __attribute__((vector_size(8 * LANES)));
#define NOTHING ((vector){0})
#define TRUTH(m) ((vector)((m) & (mask)(NOTHING + 1.)))
#define WHERE(m, a, b) ((vector)(((m) & (mask)(a)) | (~(m) & (mask)(b))))
#define MAGNITUDE(a) ((vector)((mask)(a) & 0x7fffffffffffffffLL))

@TRIGONOMETRY@
#ifndef SINE
#define SINE(a) EACH(sin, a)
#define COSINE(a) EACH(cos, a)
#endif

/* Returns the mask of lanes with an angle beyond the range of the formulas above. */
static mask wide(const vector *x, vector *y) {
  mask far = {0};
  @WIDE@
  return far;
}

/* Evaluates one lane by the code for a single state, whose sines have no limit of range. */
static void evaluate_lane(const vector *x, vector *y, int lane) {
  static const double *arg[@SZ_ARG@];
  static double *res[@SZ_RES@], w[@SZ_W@];
  static casadi_int iw[@SZ_IW@];
  double given[@IN_TOTAL@], result[@OUT_TOTAL@];
  npy_intp i, j;
  for (j = 0; j < @IN_TOTAL@; ++j) given[j] = x[j][lane];
  for (i = j = 0; i < @N_IN@; j += in_size[i++]) arg[i] = given + j;
  for (i = j = 0; i < @N_OUT@; j += out_rows[i] * out_columns[i], ++i) res[i] = result + j;
  @NAME@(arg, res, iw, w, memory);
  for (j = 0; j < @OUT_TOTAL@; ++j) y[j][lane] = result[j];
}

/* Evaluates all rows. A lane takes the next row as soon as its repetition ends, so that rows with
   many repetitions do not hold up the others. */
static void evaluate_rows(const double *const *in, const npy_intp *step, double *const *out,
                          npy_intp rows) {
  vector x[@IN_TOTAL@], y[@OUT_TOTAL@];
  double *const given = (double *)x;
  const double *const result = (const double *)y;
  npy_intp row_of[LANES], next, left = rows, j, n;
  int count[LANES], k, i;
  mask far;
  for (k = 0; k < LANES; ++k) row_of[k] = -1;
  for (next = 0; left;) {
    for (k = 0; k < LANES; ++k) {
      if (row_of[k] >= 0 || next == rows) continue;
      for (i = n = 0; i < @N_IN@; n += in_size[i++])
        if (step[i] || next < LANES || (@MOST@ && !i)) /* else the lane has it already */
          for (j = 0; j < in_size[i]; ++j) given[(n + j) * LANES + k] = in[i][next * step[i] + j];
      count[k] = 0;
      row_of[k] = next++;
    }
    far = wide(x, y);
    for (k = 0; k < LANES; ++k) {
      if (row_of[k] < 0) continue;
      if (far[k]) evaluate_lane(x, y, k);
#if @MOST@
      if (++count[k] < @MOST@ && result[@STATE@ * LANES + k] > 0) {
        for (j = 0; j < @STATE@; ++j) given[j * LANES + k] = result[j * LANES + k];
        continue;
      }
#endif
      for (i = n = 0; i < @N_OUT@; n += out_rows[i] * out_columns[i], ++i)
        for (j = 0; j < out_rows[i] * out_columns[i]; ++j)
          out[i][row_of[k] * out_rows[i] * out_columns[i] + j] = result[(n + j) * LANES + k];
      row_of[k] = -1;
      --left;
    }
  }
}
#endif

static PyObject *call(PyObject *module, PyObject *const *given, Py_ssize_t count) {
  static const double *arg[@SZ_ARG@];
  static double *res[@SZ_RES@], w[@SZ_W@];
  static casadi_int iw[@SZ_IW@];
  PyArrayObject *in[@N_IN@] = {0}, *out[@N_OUT@] = {0};
  npy_intp step[@N_IN@], rows = -1, row, size;
  PyObject *answer = NULL;
#if @KEPT@
  const double *last = NULL;
#endif
  int i;
  if (count != @N_IN@)
    return PyErr_Format(input_error, "@NAME@ takes @N_IN@ arrays, not %zd", count);
  for (i = 0; i < @N_IN@; ++i) {
    if (PyArray_CheckExact(given[i]) && PyArray_TYPE((PyArrayObject *)given[i]) == NPY_DOUBLE
        && PyArray_ISBEHAVED_RO((PyArrayObject *)given[i])
        && (PyArray_IS_C_CONTIGUOUS((PyArrayObject *)given[i])
            || (PyArray_NDIM((PyArrayObject *)given[i]) == 2 /* rows may be strided */
                && PyArray_STRIDE((PyArrayObject *)given[i], 1) == sizeof(double)))) {
      in[i] = (PyArrayObject *)given[i];
      Py_INCREF(in[i]);
    } else {
      in[i] = (PyArrayObject *)PyArray_FROM_OTF(given[i], NPY_DOUBLE, NPY_ARRAY_IN_ARRAY);
      if (!in[i]) goto done;
    }
    if (PyArray_NDIM(in[i]) < 2 && PyArray_SIZE(in[i]) == in_size[i]) {
      step[i] = 0;
    } else if (PyArray_NDIM(in[i]) == 2 && PyArray_DIM(in[i], 1) == in_size[i]
               && (rows < 0 || rows == PyArray_DIM(in[i], 0))) {
      step[i] = PyArray_STRIDE(in[i], 0) / (npy_intp)sizeof(double);
      rows = PyArray_DIM(in[i], 0);
    } else {
      PyObject *shape = PyObject_GetAttrString((PyObject *)in[i], "shape");
      PyObject *list = shape ? PySequence_List(shape) : NULL;
      if (list)
        PyErr_Format(input_error, "%s of @NAME@ must have shape [%zd] or [N, %zd], with the same N "
                     "in every batch, not %R", in_name[i], in_size[i], in_size[i], list);
      Py_XDECREF(shape);
      Py_XDECREF(list);
      goto done;
    }
  }
#if @KEPT@
  if (@MOST@ ? rows >= 0 : rows < 0 || step[0]) {
    PyErr_SetString(input_error, @MOST@ ? "@NAME@ is repeated from one state, not from a batch"
                                        : "@NAME@ goes from one state along the rows of a batch");
    goto done;
  }
  if (@MOST@) rows = @MOST@;
#endif
  for (i = 0; i < @N_OUT@; ++i) {
    npy_intp shape[3] = {rows, out_columns[i], out_rows[i]};
    int matrix = out_columns[i] != 1, batch = rows >= 0;
    if (!matrix) shape[1] = out_rows[i];
    out[i] = (PyArrayObject *)PyArray_SimpleNew(1 + matrix + batch, shape + !batch, NPY_DOUBLE);
    if (!out[i]) goto done;
  }
  row = 0;
#if @HAS_WIDE@
  if (rows >= LANES) {
    for (i = 0; i < @N_IN@; ++i) arg[i] = (double *)PyArray_DATA(in[i]);
    for (i = 0; i < @N_OUT@; ++i) res[i] = (double *)PyArray_DATA(out[i]);
    evaluate_rows(arg, step, res, rows);
    row = rows;
  }
#endif
  for (; row < (rows < 0 ? 1 : rows); ++row) {
    for (i = 0; i < @N_IN@; ++i) arg[i] = (double *)PyArray_DATA(in[i]) + row * step[i];
#if @KEPT@
    if (last) arg[0] = last;
#endif
    for (i = 0; i < @N_OUT@; ++i) {
      size = out_rows[i] * out_columns[i];
      res[i] = (double *)PyArray_DATA(out[i]) + row * size;
    }
    if (evaluate(arg, res, iw, w)) {
      PyErr_SetString(PyExc_RuntimeError, "@NAME@ could not be evaluated");
      goto done;
    }
#if @KEPT@
    last = res[0];
#if @MOST@
    if (!(res[1][0] > 0) && ++row) break;
#endif
#endif
  }
  for (i = 0; i < @N_OUT@; ++i) {
#if @KEPT@ && @MOST@
    PyObject *calls = PySequence_GetSlice((PyObject *)out[i], 0, row);
    Py_DECREF(out[i]);
    out[i] = (PyArrayObject *)calls;
    if (!calls) goto done;
#endif
    if (out_columns[i] != 1) {  /* CasADi writes column by column */
      PyObject *turned = PyArray_SwapAxes(out[i], (rows >= 0), 1 + (rows >= 0));
      Py_DECREF(out[i]);
      out[i] = (PyArrayObject *)turned;
      if (!turned) goto done;
    }
  }
  if (@N_OUT@ == 1) {
    answer = (PyObject *)out[0];
    Py_INCREF(answer);
  } else {
    answer = PyTuple_New(@N_OUT@);
    for (i = 0; answer && i < @N_OUT@; ++i) {
      Py_INCREF(out[i]);
      PyTuple_SET_ITEM(answer, i, (PyObject *)out[i]);
    }
  }
done:
  for (i = 0; i < @N_IN@; ++i) Py_XDECREF(in[i]);
  for (i = 0; i < @N_OUT@; ++i) Py_XDECREF(out[i]);
  return answer;
}

static PyMethodDef methods[] = {
  {"@NAME@", (PyCFunction)(void (*)(void))call, METH_FASTCALL, NULL}, {NULL, NULL, 0, NULL}};
static struct PyModuleDef definition = {
  PyModuleDef_HEAD_INIT, "@NAME@", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit_@NAME@(void) {
  PyObject *checks;
  import_array();
  checks = PyImport_ImportModule("microbot_ocp._base.checks");
  if (!checks) return NULL;
  input_error = PyObject_GetAttrString(checks, "InputError");
  Py_DECREF(checks);
  if (!input_error) return NULL;
  @NAME@_incref();
  memory = @NAME@_checkout();
  return PyModule_Create(&definition);
}
