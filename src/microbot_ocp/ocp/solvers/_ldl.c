/* L D L' of the symmetric matrices that IPOPT solves, behind the names of MA27's subroutines, which
 * IPOPT loads from any library: ma27id_ (defaults), ma27ad_ (order), ma27bd_ (factors), ma27cd_
 * (solution). Numbers in D alone, in an order that is fixed before: the rows of constraints get a
 * small negative diagonal, so that each pivot is there, and the refinement of each solution
 * removes what that changes (R. J. Vanderbei, Symmetric quasidefinite matrices, SIAM Journal on
 * Optimization 5, 1995). The order is AMD's, whose address order_with is given.
 *
 * Memory is IPOPT's own. Integers: number of entries, columns of the permuted upper triangle and
 * their rows, columns of L, permutation, three lists of work, rows of L. Numbers: entries as given,
 * the same permuted, diagonal, D, three vectors of work, L.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* Diagonal of a row that has none: five arms take the same iterations with 1e-8 to 1e-6 */
#define SHIFT 1e-7
#define TINY 1e-13     /* a pivot below is SHIFT in its place */
#define ACCURATE 1e-11 /* residual relative to the right side at which a solution is refined enough */
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

/* Columns of the strict upper triangle: their starts, and with `row` the rows of each. */
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
    /* IPOPT has the constraints below the variables: no entry of theirs is left of one below */
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
    for (int k = 0; k < n; k++) {
        int top = n;
        f.seen[k] = k;
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
    info[14] = (int)negative;
    *maxfrt = 1;
}

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
