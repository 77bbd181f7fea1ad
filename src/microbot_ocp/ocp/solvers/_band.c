/* Cholesky factorisation of a bordered band matrix for IPOPT, with the interface of MA27: ma27id_
 * sets defaults, ma27ad_ analyses, ma27bd_ factorises, ma27cd_ solves. It is for programs with few
 * equations among their rows. With Sigma of the slacks s and Delta of the rows y diagonal, IPOPT's
 * matrix is
 *
 *     | H    0     J'    | |x|   |a|
 *     | 0  Sigma  -I     | |s| = |b|                                                           (1)
 *     | J   -I    -Delta | |y|   |c|
 *
 * Elimination of slacks and rows, one by one, leaves
 *
 *     (H + J' W J) x = a + J' W (c + b / Sigma),    W = Sigma / (1 + Sigma Delta),             (2)
 *
 * whose matrix is positive definite exactly if (1) has the inertia that IPOPT requires
 * (A. Forsgren, P. Gill, M. Wright, Interior methods for nonlinear optimization, SIAM Review 44,
 * 2002, section 6). An equation has no slack. Eliminated with a slack of Sigma = 1 / SHIFT, its row
 * E of J adds
 *
 *     E' E / (Delta + SHIFT)                                                                   (3)
 *
 * to this matrix. For a small SHIFT the sum is positive definite exactly if the rest is so where
 * E x = 0, as IPOPT requires. The residual is that of (1), without such a slack, so refinement
 * removes the perturbation (R. J. Vanderbei, Symmetric quasidefinite matrices, SIAM Journal on
 * Optimization 5, 1995).
 *
 * Unknowns coupled to few others, such as coefficients of a spline, form a band in their given
 * order; unknowns coupled to many, such as durations, form the border. With the band matrix
 * A = L L' and the border [B C], the factor has the border X = B L^-T and the corner S with
 * S S' = C - X X'.
 *
 * All memory is allocated by IPOPT. `ikeep` holds a flag that is set once `iw` is filled, the
 * numbers of rows and equations, and the place of every unknown, negative in the border: IPOPT
 * passes `iw` as malloc returned it, with the remains of earlier solvers. Integers `iw`: the sizes;
 * the destination of each entry and the lists of rows, set up by the first factorisation. Numbers
 * `a`: entries in IPOPT's order, followed by the arrays at the offsets in Layout.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define ACCURATE 1e-11 /* residual, relative to the right side, at which refinement ends */
#define MOST_REFINED 3
#define SMALLEST 1e-14 /* least pivot that counts as positive */
#define MEMORY_LACKS (-7)
#define WIDE 8         /* numbers per vector instruction */
#define BLOCK 8        /* rows that are added in one pass */
#define WIDEST 1024    /* largest length of a column of the band */
#define SPARSE 3       /* span per entry above which a row is stored as a list */
#define HEAD 8
#define KEPT 3         /* integers before the places in `ikeep` */
#define SHIFT 1e-7     /* equation (3), as in _ldl.c */

typedef double Numbers __attribute__((vector_size(8 * WIDE)));
typedef double Unaligned __attribute__((vector_size(8 * WIDE), aligned(8)));
typedef int64_t Lanes __attribute__((vector_size(8 * WIDE)));
#define AT(p) (*(Unaligned *)(p))

typedef struct {
    int unknowns, rows, equations, border, band;
    int width, entries;                        /* column length of the band; row entries */
    int *place, *to, *start, *first, *length, *column; /* the length of a list is negative */
    long side;                                 /* padded length of a vector over the band */
    long h, f, b, l, c, s, sigma, delta, share, row, x, product, right, left, kept, waste, numbers;
} Layout;

static void lay_out(Layout *o, int count, int *iw)
{
    const long square = (long)(o->band + o->width) * o->width + 2 * WIDE, m = o->rows;
    const long corner = (long)o->border * o->border, size = o->unknowns + 2 * m - o->equations;
    o->side = o->band + o->width + 2 * WIDE;
    long at = count;
    o->h = at, at += square;   /* H by columns of the band, each from its diagonal downwards */
    o->f = at, at += square;   /* L by columns of the band */
    o->b = at, at += o->border * o->side; /* B of the border, followed by its factor */
    o->l = at, at += o->border * o->side;
    o->c = at, at += corner;
    o->s = at, at += corner;
    o->sigma = at, at += m;
    o->delta = at, at += m;
    o->share = at, at += m;    /* 1 / (1 + Sigma Delta) */
    o->row = at, at += o->entries + 2 * WIDE;
    o->x = at, at += o->side + o->border;
    o->product = at, at += o->side + o->border;
    o->right = at, at += size;
    o->left = at, at += size;
    o->kept = at, at += size;
    o->waste = at, at += 1;    /* destination of the entries -1, which the formulas contain */
    o->numbers = at;
    if (!iw) return;
    o->place = iw + HEAD, o->to = o->place + o->unknowns, o->start = o->to + count;
    o->first = o->start + m + 1;
    o->length = o->first + m, o->column = o->length + m;
}

void ma27id_(int *icntl, double *cntl)
{
    memset(icntl, 0, 30 * sizeof *icntl);
    memset(cntl, 0, 5 * sizeof *cntl);
}

static int by_size(const void *a, const void *b) { return *(const int *)a - *(const int *)b; }

static void sorted(const int *irn, const int *icn, int k, int *i, int *j)
{
    *i = (irn[k] > icn[k] ? irn[k] : icn[k]) - 1, *j = (irn[k] > icn[k] ? icn[k] : irn[k]) - 1;
}

/* Numbers of unknowns, rows m and equations. The order is unknowns, slacks, equations, other rows,
 * and the last row is coupled to the last slack: that slack is the largest index below its own. A
 * slack is coupled to nothing but the row m places behind it. */
static Layout counted(int size, int count, const int *irn, const int *icn)
{
    int last = -1, i, j, e = 0;
    for (int k = 0; k < count; k++) {
        sorted(irn, icn, k, &i, &j);
        if (i == size - 1 && j < i && j > last) last = j;
    }
    const int m = size - 1 - last, first = size - 2 * m; /* slack, without equations */
    for (int k = 0; k < count; k++) {
        sorted(irn, icn, k, &i, &j);
        if (i == j) continue;
        if (i <= last && i - first >= e) e = i - first + 1;
        if (j <= last && j - first >= e && i != j + m) e = j - first + 1;
    }
    return (Layout){.unknowns = first + e, .rows = m, .equations = e};
}

typedef struct { int degree, unknown; } Degree;

static int by_degree(const void *a, const void *b)
{
    const Degree *x = a, *y = b;
    return x->degree != y->degree ? (x->degree < y->degree) - (x->degree > y->degree)
                                  : (x->unknown > y->unknown) - (x->unknown < y->unknown);
}

/* Set the places of the unknowns; return 1 if the matrix has the structure (1). The m rows begin at
 * the index `rows`. The border holds the unknowns that are coupled to most others, as many as make
 * the factorisation cheapest: with b of them the band has the greatest distance, of two coupled
 * unknowns, among pairs of which both are coupled to fewer others than these b. */
static int order(int n, int m, int rows, int count, const int *irn, const int *icn, int *place)
{
    Degree *degree = calloc(n, sizeof *degree);
    int *rank = calloc(2L * n + 2 * m + 1 + count, sizeof *rank), *width = rank + n;
    int *start = width + n, *end = start + m, *member = end + m + 1, i, j;
    int fits = degree && rank;
    for (int k = 0; k < n && fits; k++) degree[k].unknown = k;
    for (int k = 0; k < count && fits; k++) {
        sorted(irn, icn, k, &i, &j);
        if (j < n) degree[j].degree++;
        if (i < n) degree[i].degree++;
        else if (i < rows) fits = i == j;
        else if (j < n) end[i - rows]++;
        else fits = j == i || j == i - m;
    }
    if (fits) {
        qsort(degree, n, sizeof *degree, by_degree);
        for (int k = 0; k < n; k++) rank[degree[k].unknown] = k;
        for (int r = 0; r < m; r++) {
            start[r] = r ? start[r - 1] + end[r - 1] : 0;
            if (r) end[r - 1] = start[r - 1];
        }
        if (m) end[m - 1] = start[m - 1];
        for (int k = 0; k < count; k++) {
            sorted(irn, icn, k, &i, &j);
            if (i < n) {
                const int least = rank[i] < rank[j] ? rank[i] : rank[j], apart = abs(i - j) + 1;
                if (width[least] < apart) width[least] = apart;
            } else if (i >= rows && j < n) member[end[i - rows]++] = rank[j];
        }
        for (int r = 0; r < m; r++) {
            int low = n, high = -1;
            qsort(member + start[r], end[r] - start[r], sizeof *member, by_size);
            for (int k = end[r] - 1; k >= start[r]; k--) {
                const int each = degree[member[k]].unknown;
                low = each < low ? each : low, high = each > high ? each : high;
                if (width[member[k]] < high - low + 1) width[member[k]] = high - low + 1;
            }
        }
        int border = n, wide = 1;
        double least = INFINITY;
        for (int b = n; b >= 0; b--) {
            const double band = n - b;
            if (b < n && width[b] > wide) wide = width[b];
            const double work = band * wide * wide + b * band * (2.0 * wide + b) + (double)b * b * b;
            if (wide <= WIDEST && work <= least) least = work, border = b;
        }
        int inside = 0, outside = 0;
        for (int k = 0; k < n; k++) place[k] = rank[k] < border ? -1 - outside++ : inside++;
    }
    free(degree);
    free(rank);
    return fits;
}

/* Set the sizes in `o`, and the lists in `iw` if it is given. Return 0 if memory is short. */
static int analyse(Layout *o, int size, int count, const int *irn, const int *icn,
                   const int *place, int *iw)
{
    const int m = o->rows, n = o->unknowns, rows = size - m;
    int *low = malloc((4L * m + 1) * sizeof *low), *high = low + m, *held = low + 2 * m;
    int *edges = low + 3 * m, i, j;
    if (!low) return 0;
    o->border = o->band = 0, o->width = 1, o->entries = 0;
    for (int k = 0; k < n; k++) place[k] < 0 ? o->border++ : o->band++;
    for (int r = 0; r < m; r++) low[r] = o->band, high[r] = -1, held[r] = edges[r] = 0;
    for (int k = 0; k < count; k++) {
        sorted(irn, icn, k, &i, &j);
        if (j >= n) continue;
        const int p = place[j], r = i - rows;
        if (i < n && p >= 0 && place[i] >= 0 && abs(place[i] - p) >= o->width)
            o->width = abs(place[i] - p) + 1;
        if (i < n) continue;
        if (p < 0) edges[r]++;
        else held[r]++, low[r] = p < low[r] ? p : low[r], high[r] = p > high[r] ? p : high[r];
    }
    for (int r = 0; r < m; r++) {
        const int span = held[r] ? high[r] - low[r] + 1 : 0;
        if (span > o->width) o->width = span;
        high[r] = SPARSE * held[r] >= span ? span : -held[r]; /* from here on the length */
        o->entries += abs(high[r]) + edges[r];
    }
    o->width = (o->width + WIDE - 1) / WIDE * WIDE;
    lay_out(o, count, iw);
    for (int r = 0; r < m && iw; r++) {
        o->start[r] = r ? o->start[r - 1] + abs(o->length[r - 1]) + edges[r - 1] : 0;
        o->first[r] = held[r] ? low[r] : 0, o->length[r] = high[r];
        if (r) edges[r - 1] = held[r - 1] = 0;
    }
    if (iw) {
        o->start[m] = o->start[m - 1] + abs(o->length[m - 1]) + edges[m - 1];
        edges[m - 1] = held[m - 1] = 0;
        memset(o->column, 0, o->entries * sizeof *o->column);
    }
    /* Destination of every entry: H of band, border or corner, Sigma, Delta, or a row of J. */
    for (int k = 0; k < count && iw; k++) {
        long to = o->waste;
        sorted(irn, icn, k, &i, &j);
        if (i < n) {
            const int p = place[i], q = place[j], s = -1 - p, t = -1 - q;
            if (p >= 0 && q >= 0) to = o->h + (long)(p < q ? p : q) * o->width + abs(p - q);
            else if (p < 0 && q < 0)
                to = o->c + (long)(s > t ? s : t) * o->border + (s > t ? t : s);
            else to = o->b + (p < 0 ? s : t) * o->side + (p < 0 ? q : p);
        } else if (i < rows) to = o->sigma + i + m - rows;
        else if (i == j) to = o->delta + i - rows;
        else if (j < n) {
            const int r = i - rows, begin = o->start[r], length = o->length[r];
            int at = begin + place[j] - o->first[r];
            if (place[j] < 0)
                at = begin + abs(length) + edges[r]++, o->column[at] = (int)o->side - 1 - place[j];
            else if (length < 0) at = begin + held[r]++, o->column[at] = place[j];
            to = o->row + at;
        }
        o->to[k] = (int)to;
    }
    free(low);
    return 1;
}

void ma27ad_(const int *size, const int *entries, const int *irn, const int *icn, int *iw,
             const int *liw, int *ikeep, int *iw1, int *nsteps, int *iflag, int *icntl,
             double *cntl, int *info, double *ops)
{
    Layout o = counted(*size, *entries, irn, icn);
    (void)iw, (void)liw, (void)iw1, (void)iflag, (void)icntl, (void)cntl;
    memset(info, 0, 20 * sizeof *info);
    *nsteps = 1, *ops = 0, info[0] = MEMORY_LACKS;
    const int n = o.unknowns, m = o.rows;
    int *place = ikeep + KEPT;
    if (n < 1 || m <= o.equations || !order(n, m, *size - m, *entries, irn, icn, place)) return;
    if (!analyse(&o, *size, *entries, irn, icn, place, NULL) || o.width > WIDEST) return;
    const int64_t integers = HEAD + n + (int64_t)*entries + 3 * m + 1 + o.entries;
    if (o.numbers > INT32_MAX / 2 || integers > INT32_MAX / 2) return;
    ikeep[0] = 0, ikeep[1] = m, ikeep[2] = o.equations; /* nothing is in `iw` yet */
    info[0] = 0, info[4] = (int)o.numbers, info[5] = (int)integers;
}

/* Add J' W J of the rows r to end - 1, which share their columns, to the band: (2) and (3). */
static void add_block(const Layout *o, double *a, int r, int end, const double *weight)
{
    const int length = o->length[r], width = o->width;
    const Lanes lane = {0, 1, 2, 3, 4, 5, 6, 7};
    for (int i = 0; i < length; i++) {
        double *to = a + o->f + (long)(o->first[r] + i) * width, factor[BLOCK];
        const double *row[BLOCK];
        for (int k = r; k < end; k++) {
            row[k - r] = a + o->row + o->start[k];
            factor[k - r] = weight[k - r] * row[k - r][i];
        }
        for (int q = i; q < length; q += WIDE) {
            Numbers sum = AT(to + q - i);
            for (int k = 0; k < end - r; k++) {
                /* A vector may reach into the next row of J: zero the numbers beyond this row. */
                const Lanes part = (Lanes)AT(row[k] + q) & (lane < length - q);
                sum += factor[k] * (Numbers)part;
            }
            AT(to + q - i) = sum;
        }
    }
}

/* Add the part of w J' J of one row outside the band, and the band part of a list. */
static void add_row(const Layout *o, double *a, int r, double weight)
{
    const double *value = a + o->row + o->start[r];
    const int length = abs(o->length[r]), *column = o->column + o->start[r];
    const int edges = o->start[r + 1] - o->start[r] - length;
    const int is_list = o->length[r] < 0;
    for (int i = 0; i < length && is_list; i++)
        for (int q = 0; q <= i; q++) {
            const int low = column[i] < column[q] ? column[i] : column[q];
            a[o->f + (long)low * o->width + abs(column[i] - column[q])] +=
                weight * value[i] * value[q];
        }
    for (int e = 0; e < edges; e++) {
        const int b = column[length + e] - (int)o->side;
        const double factor = weight * value[length + e];
        double *to = a + o->l + b * o->side + (is_list ? 0 : o->first[r]);
        if (is_list)
            for (int q = 0; q < length; q++) to[column[q]] += factor * value[q];
        else
            for (int q = 0; q < length; q++) to[q] += factor * value[q];
        for (int d = 0; d < edges; d++) {
            const int other = column[length + d] - (int)o->side;
            if (other <= b) a[o->s + b * o->border + other] += factor * value[length + d];
        }
    }
}

static int same_columns(const Layout *o, int r, int q)
{
    return o->length[r] > 0 && o->length[r] == o->length[q] && o->first[r] == o->first[q];
}

/* Right-looking Cholesky factorisation of the band; return 0 at a pivot that is not positive. */
static int factor_band(const Layout *o, double *a)
{
    const int width = o->width, n = o->band;
    for (int j = 0; j < n; j++) {
        double *column = a + o->f + (long)j * width, kept[WIDEST + WIDE];
        if (!(column[0] > SMALLEST)) return 0;
        const double pivot = sqrt(column[0]), inverse = 1.0 / pivot;
        int length = width < n - j ? width : n - j;
        /* Trailing zeros stay zero: a short column updates few others. */
        while (length > 1 && column[length - 1] == 0.0) length--;
        for (int i = 0; i < length; i++) kept[i] = column[i] *= inverse;
        /* Zeros behind the column complete the last vector of every update. */
        for (int i = length; i < length + WIDE; i++) kept[i] = 0.0;
        for (int i = 1; i < length; i++) {
            double *to = column + (long)i * width;
            for (int q = i; q < length; q += WIDE)
                AT(to + q - i) -= kept[i] * AT(kept + q);
        }
    }
    return 1;
}

/* Solve L x = b of the band in place. */
static void forward(const Layout *o, const double *a, double *x)
{
    for (int j = 0; j < o->band; j++) {
        const double *column = a + o->f + (long)j * o->width;
        const double value = x[j] /= column[0];
        for (int i = 1; i < o->width; i++) x[j + i] -= column[i] * value;
    }
}

/* Border of the factor, B L^-T, and Cholesky factor S of the Schur complement of the band. */
static int factor_border(const Layout *o, double *a)
{
    const int nb = o->border;
    double *s = a + o->s;
    for (int b = 0; b < nb; b++) {
        double *x = a + o->l + b * o->side;
        forward(o, a, x);
        for (int q = 0; q <= b; q++) {
            const double *y = a + o->l + q * o->side;
            double sum = s[b * nb + q];
            for (int j = 0; j < o->band; j++) sum -= x[j] * y[j];
            for (int k = 0; k < q; k++) sum -= s[b * nb + k] * s[q * nb + k];
            if (q < b) s[b * nb + q] = sum / s[q * nb + q];
            else if (!(sum > SMALLEST)) return 0;
            else s[b * nb + b] = sqrt(sum);
        }
    }
    return 1;
}

void ma27bd_(const int *size, const int *entries, const int *irn, const int *icn, double *a,
             const int *la, int *iw, const int *liw, int *ikeep, const int *nsteps, int *maxfrt,
             int *iw1, int *icntl, double *cntl, int *info)
{
    const int count = *entries;
    (void)la, (void)liw, (void)nsteps, (void)iw1, (void)icntl, (void)cntl;
    memset(info, 0, 20 * sizeof *info);
    *maxfrt = 1;
    const int m = ikeep[1], e = ikeep[2], n = *size - 2 * m + e, *place = ikeep + KEPT;
    Layout o = {.unknowns = n, .rows = m, .equations = e};
    /* The lists of an analysis are set up by its first factorisation. */
    if (!ikeep[0]) {
        if (!analyse(&o, *size, count, irn, icn, place, iw)) {
            info[0] = MEMORY_LACKS;
            return;
        }
        memcpy(o.place, place, n * sizeof *place);
        const int sizes[HEAD] = {n, m, e, o.border, o.band, o.width, o.entries, count};
        memcpy(iw, sizes, sizeof sizes);
        ikeep[0] = 1;
    }
    o.border = iw[3], o.band = iw[4], o.width = iw[5], o.entries = iw[6];
    lay_out(&o, count, iw);
    memset(a + count, 0, (o.x - count) * sizeof *a);
    a[o.waste] = 0.0;
    for (int k = 0; k < count; k++) a[o.to[k]] += a[k];
    if (a[o.waste] != e - m) { /* entries of slacks are not -1 */
        info[0] = MEMORY_LACKS;
        return;
    }
    for (int r = 0; r < e; r++) a[o.sigma + r] = 1.0 / SHIFT;
    memcpy(a + o.f, a + o.h, (o.b - o.f) * sizeof *a);
    memcpy(a + o.l, a + o.b, (o.c - o.l) * sizeof *a);
    memcpy(a + o.s, a + o.c, (o.sigma - o.s) * sizeof *a);
    for (int r = 0, end; r < m; r = end) {
        double weight[BLOCK];
        for (end = r; end < m && end < r + BLOCK && (end == r || same_columns(&o, r, end)); end++) {
            const double sigma = a[o.sigma + end];
            a[o.share + end] = 1.0 / (1.0 - sigma * a[o.delta + end]); /* delta holds -Delta */
            weight[end - r] = sigma * a[o.share + end];
            add_row(&o, a, end, weight[end - r]);
        }
        if (o.length[r] > 0) add_block(&o, a, r, end, weight);
    }
    /* Inertia of (1): m negative eigenvalues, if the matrix of (2) and (3) is positive definite. */
    info[14] = factor_band(&o, a) && factor_border(&o, a) ? m : m + 1;
}

/* Product of row r of J with a vector over band and border. */
static inline double row_times(const Layout *o, const double *a, int r, const double *x)
{
    const double *value = a + o->row + o->start[r];
    const int count = o->start[r + 1] - o->start[r], *column = o->column + o->start[r];
    double sum = 0.0;
    int q = 0;
    for (; q < o->length[r]; q++) sum += value[q] * x[o->first[r] + q];
    for (; q < count; q++) sum += value[q] * x[column[q]];
    return sum;
}

/* Add a multiple of row r of J to a vector over band and border. */
static inline void add_times_row(const Layout *o, const double *a, int r, double factor, double *x)
{
    const double *value = a + o->row + o->start[r];
    const int count = o->start[r + 1] - o->start[r], *column = o->column + o->start[r];
    int q = 0;
    for (; q < o->length[r]; q++) x[o->first[r] + q] += value[q] * factor;
    for (; q < count; q++) x[column[q]] += value[q] * factor;
}

/* Replace the right side by the solution: x by (2) and (3), followed by y and s by (1). */
static void solve(const Layout *o, double *a, const int *place, double *right)
{
    const int nb = o->border, m = o->rows, n = o->unknowns, e = o->equations;
    double *x = a + o->x, *border = x + o->side, *of_slacks = right + n - e;
    double *of_rows = of_slacks + m;
    const double *s = a + o->s;
    memset(x, 0, (o->side + nb) * sizeof *x);
    for (int i = 0; i < n; i++) (place[i] < 0 ? border - 1 - place[i] : x + place[i])[0] = right[i];
    for (int r = 0; r < m; r++) {
        const double sum = a[o->sigma + r] * of_rows[r] + (r < e ? 0.0 : of_slacks[r]);
        add_times_row(o, a, r, sum * a[o->share + r], x);
    }
    /* Band and border of the factor: L z = x and S w = border - X z, */
    forward(o, a, x);
    for (int b = 0; b < nb; b++) {
        const double *l = a + o->l + b * o->side;
        for (int j = 0; j < o->band; j++) border[b] -= l[j] * x[j];
        for (int k = 0; k < b; k++) border[b] -= s[b * nb + k] * border[k];
        border[b] /= s[b * nb + b];
    }
    /* and backwards S' border = w and L' x = z - X' border. */
    for (int b = nb - 1; b >= 0; b--) {
        for (int k = b + 1; k < nb; k++) border[b] -= s[k * nb + b] * border[k];
        border[b] /= s[b * nb + b];
        const double *l = a + o->l + b * o->side;
        for (int j = 0; j < o->band; j++) x[j] -= l[j] * border[b];
    }
    for (int j = o->band; j < o->side; j++) x[j] = 0.0;
    for (int j = o->band - 1; j >= 0; j--) {
        const double *column = a + o->f + (long)j * o->width;
        double value = x[j];
        for (int i = 1; i < o->width; i++) value -= column[i] * x[j + i];
        x[j] = value / column[0];
    }
    for (int i = 0; i < n; i++) right[i] = place[i] < 0 ? border[-1 - place[i]] : x[place[i]];
    for (int r = 0; r < m; r++) {
        const double along = row_times(o, a, r, x) - of_rows[r];
        const double slack = r < e ? 0.0 : of_slacks[r];
        of_rows[r] = (a[o->sigma + r] * along - slack) * a[o->share + r];
        if (r >= e) of_slacks[r] = along + a[o->delta + r] * of_rows[r];
    }
}

/* Euclidean norm. */
static double norm(const double *x, int count)
{
    double sum = 0.0;
    for (int i = 0; i < count; i++) sum += x[i] * x[i];
    return sqrt(sum);
}

/* Set `left` to the right side of (1) minus matrix times solution; return its norm. */
static double residual(const Layout *o, double *a, const int *place, const double *right,
                       const double *solution, double *left)
{
    const int n = o->unknowns, m = o->rows, nb = o->border, band = o->band, e = o->equations;
    const double *s = solution + n - e, *y = s + m, *of_slacks = right + n - e;
    const double *of_rows = of_slacks + m;
    double *x = a + o->x, *product = a + o->product;
    memset(x, 0, (o->side + nb) * sizeof *x);
    memset(product, 0, (o->side + nb) * sizeof *product);
    for (int i = 0; i < n; i++)
        (place[i] < 0 ? x + o->side - 1 - place[i] : x + place[i])[0] = solution[i];
    for (int r = 0; r < m; r++) {
        const double slack = r < e ? 0.0 : s[r];
        if (r >= e) left[n - e + r] = of_slacks[r] - a[o->sigma + r] * slack + y[r];
        left[n - e + m + r] = of_rows[r] - row_times(o, a, r, x) + slack - a[o->delta + r] * y[r];
        add_times_row(o, a, r, y[r], product);
    }
    /* The columns of H hold its lower triangle: an entry off the diagonal counts twice. */
    for (int j = 0; j < band; j++) {
        const double *column = a + o->h + (long)j * o->width;
        double sum = column[0] * x[j];
        for (int i = 1; i < o->width; i++) {
            sum += column[i] * x[j + i];
            product[j + i] += column[i] * x[j];
        }
        product[j] += sum;
    }
    for (int b = 0; b < nb; b++) {
        const double *of_border = a + o->b + b * o->side, *corner = a + o->c;
        double sum = 0.0;
        for (int j = 0; j < band; j++) {
            sum += of_border[j] * x[j];
            product[j] += of_border[j] * x[o->side + b];
        }
        for (int d = 0; d < nb; d++)
            sum += (d < b ? corner[b * nb + d] : corner[d * nb + b]) * x[o->side + d];
        product[o->side + b] += sum;
    }
    for (int i = 0; i < n; i++)
        left[i] = right[i] - product[place[i] < 0 ? o->side - 1 - place[i] : place[i]];
    return norm(left, n + 2 * m - e);
}

void ma27cd_(const int *size, double *a, const int *la, int *iw, const int *liw, double *w,
             const int *maxfrt, double *rhs, int *iw1, const int *nsteps, int *icntl, double *cntl)
{
    const int length = *size, *place;
    (void)la, (void)liw, (void)w, (void)maxfrt, (void)iw1, (void)nsteps, (void)icntl, (void)cntl;
    Layout o = {.unknowns = iw[0], .rows = iw[1], .equations = iw[2], .border = iw[3]};
    o.band = iw[4], o.width = iw[5], o.entries = iw[6];
    lay_out(&o, iw[7], iw);
    place = o.place;
    double *right = a + o.right, *left = a + o.left, *kept = a + o.kept, last;
    memcpy(right, rhs, length * sizeof *right);
    const double wanted = ACCURATE * norm(rhs, length);
    solve(&o, a, place, rhs);
    last = residual(&o, a, place, right, rhs, left);
    for (int round = 0; round < MOST_REFINED && last > wanted; round++) {
        memcpy(kept, rhs, length * sizeof *kept);
        solve(&o, a, place, left);
        for (int i = 0; i < length; i++) rhs[i] += left[i];
        const double now = residual(&o, a, place, right, rhs, left);
        if (!(now < last)) {
            memcpy(rhs, kept, length * sizeof *kept);
            break;
        }
        last = now;
    }
}
