/* What makes CasADi's C code of one function, which stands before, a module of Python.

   fast_calls.py puts sizes and names in the place of what stands between two at signs. The work
   arrays may be static: the interpreter's lock is held from the first to the last row. */
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

static int evaluate(const double **arg, double **res, casadi_int *iw, double *w) {
#if @MOST@
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

static PyObject *call(PyObject *module, PyObject *const *given, Py_ssize_t count) {
  static const double *arg[@SZ_ARG@];
  static double *res[@SZ_RES@], w[@SZ_W@];
  static casadi_int iw[@SZ_IW@];
  PyArrayObject *in[@N_IN@] = {0}, *out[@N_OUT@] = {0};
  npy_intp step[@N_IN@], rows = -1, row, size;
  PyObject *answer = NULL;
  int i;
  if (count != @N_IN@)
    return PyErr_Format(input_error, "@NAME@ takes @N_IN@ arrays, not %zd", count);
  for (i = 0; i < @N_IN@; ++i) {
    if (PyArray_CheckExact(given[i]) && PyArray_TYPE((PyArrayObject *)given[i]) == NPY_DOUBLE
        && PyArray_IS_C_CONTIGUOUS((PyArrayObject *)given[i])
        && PyArray_ISBEHAVED_RO((PyArrayObject *)given[i])) {
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
      step[i] = in_size[i];
      rows = PyArray_DIM(in[i], 0);
    } else {
      PyErr_Format(input_error, "%s of @NAME@ must have shape [%zd] or [N, %zd], with the same N "
                   "in every batch", in_name[i], in_size[i], in_size[i]);
      goto done;
    }
  }
  for (i = 0; i < @N_OUT@; ++i) {
    npy_intp shape[3] = {rows, out_columns[i], out_rows[i]};
    int matrix = out_columns[i] != 1, batch = rows >= 0;
    if (!matrix) shape[1] = out_rows[i];
    out[i] = (PyArrayObject *)PyArray_SimpleNew(1 + matrix + batch, shape + !batch, NPY_DOUBLE);
    if (!out[i]) goto done;
  }
  for (row = 0; row < (rows < 0 ? 1 : rows); ++row) {
    for (i = 0; i < @N_IN@; ++i) arg[i] = (double *)PyArray_DATA(in[i]) + row * step[i];
    for (i = 0; i < @N_OUT@; ++i) {
      size = out_rows[i] * out_columns[i];
      res[i] = (double *)PyArray_DATA(out[i]) + row * size;
    }
    if (evaluate(arg, res, iw, w)) {
      PyErr_SetString(PyExc_RuntimeError, "@NAME@ could not be evaluated");
      goto done;
    }
  }
  for (i = 0; i < @N_OUT@; ++i) {
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
