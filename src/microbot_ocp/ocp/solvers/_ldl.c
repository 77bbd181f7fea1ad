/* L D L' factorisation of symmetric quasidefinite matrices for IPOPT, with the interface of MA27:
 * ma27id_ sets defaults, ma27ad_ orders, ma27bd_ factorises, ma27cd_ solves.
 *
 * D is diagonal and the order is fixed in advance. Constraint rows get a small negative diagonal,
 * so that every pivot exists, and iterative refinement removes the perturbation from each solution
 * (R. J. Vanderbei, Symmetric quasidefinite matrices, SIAM Journal on Optimization 5, 1995). The
 * order is AMD's; order_with receives the address of the function. The elimination tree and the
 * up-looking factorisation follow T. A. Davis, Direct Methods for Sparse Linear Systems (2006),
 * chapter 4.
 *
 * All memory is allocated by IPOPT. Integers: number of entries; column starts and rows of the
 * permuted upper triangle; column starts of L; permutation; three work arrays; rows of L. Numbers:
 * entries in IPOPT's order; the permuted entries; diagonal; D; three work vectors; L.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* Diagonal of a constraint row: five arms need equally many iterations for 1e-8 to 1e-6. */
#define SHIFT 1e-7
#define TINY 1e-13     /* magnitude of a pivot below which SHIFT replaces it */
#define ACCURATE 1e-11 /* residual, relative to the right side, at which refinement ends */
#define MOST_REFINED 8
#define MEMORY_LACKS (-7)

typedef long (*order_function)(long, const long *, const long *, long *, double *, double *);
static order_function amd;

void order_with(order_function given) { amd = given; }

void ma27id_(int *icntl, double *cntl)
{
    memset(icntl, 0, 30 * sizeof *icntl);
    memset(cntl, 0, 5 * sizeof *cntl);
}

/* Sort the permuted entries of the strict upper triangle by columns (counting sort): `start` and
 * `row` receive the structure, `kept` and `diagonal` the values if `value` is given. */
static void columns(int n, int count, const int *irn, const int *icn, const int *place, int *start,
                    int *next, int *row, const double *value, double *kept, double *diagonal)
{
    memset(start, 0, (n + 1) * sizeof *start);
    for (int k = 0; k < count; k++) {
        int i = place[irn[k] - 1], j = place[icn[k] - 1];
        if (i != j) start[(i > j ? i : j) + 1]++;
    }
    for (int j = 0; j < n; j++) next[j] = start[j + 1] += start[j];
    for (int k = count - 1; k >= 0; k--) {
        int i = place[irn[k] - 1], j = place[icn[k] - 1];
        if (i != j) {
            int at = --next[i > j ? i : j];
            row[at] = i > j ? j : i;
            if (value) kept[at] = value[k];
        } else if (value) {
            diagonal[i] += value[k];
        }
    }
}

void ma27ad_(const int *size, const int *entries, const int *irn, const int *icn, int *iw,
             const int *liw, int *ikeep, int *iw1, int *nsteps, int *iflag, int *icntl,
             double *cntl, int *info, double *ops)
{
    int n = *size, count = *entries, *place = ikeep, *parent = ikeep + n, *length = ikeep + 2 * n;
    (void)iw, (void)liw, (void)iw1, (void)iflag, (void)icntl, (void)cntl;
    memset(info, 0, 20 * sizeof *info);
    int *start = malloc((n + 1) * sizeof *start), *seen = malloc((n + 1) * sizeof *seen);
    int *row = malloc((count + 1) * sizeof *row);
    long *far = malloc((2L * n + 2 + count) * sizeof *far);
    if (!amd || !start || !seen || !row || !far) {
        info[0] = MEMORY_LACKS;
        goto end;
    }
    long *far_start = far, *order = far + n + 1, *far_row = far + 2 * n + 2;
    for (int k = 0; k < n; k++) place[k] = k;
    columns(n, count, irn, icn, place, start, seen, row, NULL, NULL, NULL);
    for (int k = 0; k <= n; k++) far_start[k] = start[k];
    for (int k = 0; k < start[n]; k++) far_row[k] = row[k];
    if (amd(n, far_start, far_row, order, NULL, NULL) < 0) {
        info[0] = MEMORY_LACKS;
        goto end;
    }
    for (int k = 0; k < n; k++) place[order[k]] = k;
    columns(n, count, irn, icn, place, start, seen, row, NULL, NULL, NULL);
    /* Elimination tree: row k of L has entries on the paths from the entries of column k of the
     * upper triangle towards the root, as far as they are not marked by k. */
    int64_t total = 0;
    for (int k = 0; k < n; k++) {
        parent[k] = -1, seen[k] = k, length[k] = 0;
        for (int p = start[k]; p < start[k + 1]; p++)
            for (int i = row[p]; seen[i] != k; i = parent[i]) {
                if (parent[i] < 0) parent[i] = k;
                length[i]++, total++, seen[i] = k;
            }
    }
    if (2 * (int64_t)count + total + 8 * (int64_t)n > INT32_MAX / 2) {
        info[0] = MEMORY_LACKS;
        goto end;
    }
    info[4] = (int)(2 * count + total + 5 * n);     /* numbers */
    info[5] = (int)(count + total + 6 * n + 3);     /* integers */
    *nsteps = n;
    *ops = (double)total;
end:
    free(start), free(seen), free(row), free(far);
}

typedef struct {
    int *start, *row, *l_start, *order, *filled, *seen, *path, *l_row;
    double *value, *diagonal, *d, *x, *residual, *right, *l;
} Factors;

static Factors factors_in(int n, int count, int *iw, double *a)
{
    Factors f;
    f.start = iw + 1, f.row = f.start + n + 1, f.l_start = f.row + count;
    f.order = f.l_start + n + 1, f.filled = f.order + n, f.seen = f.filled + n;
    f.path = f.seen + n, f.l_row = f.path + n;
    f.value = a + count, f.diagonal = f.value + count, f.d = f.diagonal + n;
    f.x = f.d + n, f.residual = f.x + n, f.right = f.residual + n, f.l = f.right + n;
    return f;
}

void ma27bd_(const int *size, const int *entries, const int *irn, const int *icn, double *a,
             const int *la, int *iw, const int *liw, int *ikeep, const int *nsteps, int *maxfrt,
             int *iw1, int *icntl, double *cntl, int *info)
{
    int n = *size, count = *entries, *place = ikeep, *parent = ikeep + n, *length = ikeep + 2 * n;
    (void)la, (void)liw, (void)nsteps, (void)iw1, (void)icntl, (void)cntl;
    Factors f = factors_in(n, count, iw, a);
    double *y = f.x, negative = 0;
    iw[0] = count;
    memset(f.diagonal, 0, n * sizeof *f.diagonal);
    columns(n, count, irn, icn, place, f.start, f.filled, f.row, a, f.value, f.diagonal);
    /* IPOPT's matrix is [H J'; J 0]: only a constraint row has no off-diagonal entry below its
     * diagonal. Such rows get -SHIFT, the others SHIFT. */
    for (int k = 0; k < n; k++) f.path[k] = 1;
    for (int k = 0; k < count; k++)
        if (irn[k] != icn[k]) f.path[(irn[k] < icn[k] ? irn[k] : icn[k]) - 1] = 0;
    for (int k = 0; k < n; k++) {
        f.order[place[k]] = k;
        f.right[place[k]] = f.path[k] ? -SHIFT : SHIFT;
    }
    f.l_start[0] = 0;
    for (int k = 0; k < n; k++) {
        f.l_start[k + 1] = f.l_start[k] + length[k];
        f.filled[k] = 0, y[k] = 0.0, f.seen[k] = -1;
    }
    /* Up-looking, with K = 0:k-1: L(K, K) y = A(K, k), L(k, K)' = D^-1 y,
     * D(k) = A(k, k) - L(k, K) y. */
    for (int k = 0; k < n; k++) {
        int top = n;
        f.seen[k] = k;
        /* path[top..n-1]: nonzeros of row k in topological order, that is, children first. */
        for (int p = f.start[k]; p < f.start[k + 1]; p++) {
            int i = f.row[p], depth = 0;
            y[i] += f.value[p];
            for (; f.seen[i] != k; i = parent[i]) f.path[depth++] = i, f.seen[i] = k;
            while (depth > 0) f.path[--top] = f.path[--depth];
        }
        double d = f.diagonal[k];
        if (d == 0.0) d = f.right[k];
        for (; top < n; top++) {
            int i = f.path[top], end = f.l_start[i] + f.filled[i]++;
            double of_i = y[i], entry = of_i / f.d[i];
            y[i] = 0.0;
            for (int p = f.l_start[i]; p < end; p++) y[f.l_row[p]] -= f.l[p] * of_i;
            d -= entry * of_i;
            f.l_row[end] = k, f.l[end] = entry;
        }
        if (fabs(d) < TINY) d = f.right[k];
        if (d < 0) negative++;
        f.d[k] = d;
    }
    memset(info, 0, 20 * sizeof *info);
    info[14] = (int)negative; /* IPOPT checks the inertia, and regularises if it is wrong */
    *maxfrt = 1;
}

/* Solve L D L' x = b in place. */
static void substitute(int n, const Factors *f, double *x)
{
    for (int j = 0; j < n; j++)
        for (int p = f->l_start[j]; p < f->l_start[j + 1]; p++) x[f->l_row[p]] -= f->l[p] * x[j];
    for (int j = n - 1; j >= 0; j--) {
        double value = x[j] / f->d[j];
        for (int p = f->l_start[j]; p < f->l_start[j + 1]; p++) value -= f->l[p] * x[f->l_row[p]];
        x[j] = value;
    }
}

/* Largest magnitude. */
static double largest(int n, const double *x)
{
    double most = 0.0;
    for (int k = 0; k < n; k++)
        if (!(fabs(x[k]) <= most)) most = fabs(x[k]);
    return most;
}

void ma27cd_(const int *size, double *a, const int *la, int *iw, const int *liw, double *w,
             const int *maxfrt, double *rhs, int *iw1, const int *nsteps, int *icntl, double *cntl)
{
    int n = *size;
    (void)la, (void)liw, (void)w, (void)maxfrt, (void)iw1, (void)nsteps, (void)icntl, (void)cntl;
    Factors f = factors_in(n, iw[0], iw, a);
    double last = INFINITY;
    for (int k = 0; k < n; k++) f.x[k] = f.right[k] = rhs[f.order[k]];
    double wanted = ACCURATE * largest(n, f.right);
    substitute(n, &f, f.x);
    /* Iterative refinement with the unshifted matrix, as long as the residual halves. */
    for (int round = 0; round < MOST_REFINED; round++) {
        memcpy(f.residual, f.right, n * sizeof *f.right);
        for (int j = 0; j < n; j++) {
            double sum = f.diagonal[j] * f.x[j];
            for (int p = f.start[j]; p < f.start[j + 1]; p++) {
                f.residual[f.row[p]] -= f.value[p] * f.x[j];
                sum += f.value[p] * f.x[f.row[p]];
            }
            f.residual[j] -= sum;
        }
        double left = largest(n, f.residual);
        if (!(left > wanted && left < 0.5 * last)) break;
        last = left;
        substitute(n, &f, f.residual);
        for (int k = 0; k < n; k++) f.x[k] += f.residual[k];
    }
    for (int k = 0; k < n; k++) rhs[f.order[k]] = f.x[k];
}
