/* Loops of a flat program over its windows; equations (2) and (3) of docs/theory/flat.md, arrays of
 * _flat_loops.py. Lists of places hold the index of each entry among a matrix's nonzeros, -1 for an
 * entry that the program does not have. All arrays are row-major; letters are those of the python
 * file: k a window, m an unknown of the M in it, p a place of 3, d an order of derivative, i a joint
 * of n, r a limit of R, j a limited torque rate of J.
 */
#include <string.h>

#define ORDERS 3
#define PLACES 3

/* Slopes of the parabola through three values, at start and end, times half an interval. */
static const double SLOPES[2][PLACES] = {{-1.5, 2.0, -0.5}, {0.5, -2.0, 1.5}};

typedef struct {
    long count, unknowns, own_begin, own_end, inside; /* inside: 1 for intervals, 0 for ends */
    const int *phase, *columns, *points;
    const double *powers, *anchored, *weights, *jerks, *lengths;
    /* Places of the entries of the Jacobian and of the Hessian, as in WindowPlaces. */
    const int *limit, *limit_time, *bound, *bound_time, *rate, *rate_time, *jerk, *jerk_time;
    const int *hessian, *hessian_time, *time_time;
    /* Motion in the windows, as in MovedWindows; e are the weights of the jerk j. */
    double *w, *w_time, *y, *y_time, *y_second, *e, *e_time, *j, *j_time, *j_second;
} Windows;

typedef struct {
    long joints, rows, rated, friction, pairs, points;
    const int *torque, *first, *second;
    const double *bound_scale, *rate_scale, *jerk_scale, *jerk_weight, *typical, *starts;
} Form;

/* t to an integer power, by repeated multiplication. */
static double power(double t, double exponent)
{
    double value = 1.0;
    for (int k = (int)exponent; k > 0; k--) value *= t;
    for (int k = (int)exponent; k < 0; k++) value /= t;
    return value;
}

/* Equation (2) at some places of window k, with first and second derivatives by the duration T:
 * y_d = sum_m W_dm T^(p_m - d) u_m for the orders d = lowest to lowest + orders - 1. Positions are
 * relative to the start of the phase, so anchored unknowns have it subtracted.
 */
static void moved(const Windows *s, const Form *f, long k, int places, int orders, int lowest,
                  const double *weights, const double *x, double T, double *w, double *w_time,
                  double *y, double *y_time, double *y_second)
{
    const long M = s->unknowns, n = f->joints;
    const int *columns = s->columns + k * M;
    const double *from = f->starts + s->phase[k] * n;
    memset(y, 0, places * orders * n * sizeof *y);
    memset(y_time, 0, places * orders * n * sizeof *y);
    memset(y_second, 0, places * orders * n * sizeof *y);
    for (int d = 0; d < orders; d++)
        for (long m = 0; m < M; m++) {
            const double exponent = s->powers[k * M + m] - (d + lowest);
            const double times = power(T, exponent), *u = x + columns[m];
            const double anchored = s->anchored[k * M + m];
            for (int p = 0; p < places; p++) {
                const long at = (p * orders + d) * M + m, to = (p * orders + d) * n;
                const double a = weights[at] * times, b = a * exponent / T;
                const double c = b * (exponent - 1.0) / T;
                w[at] = a, w_time[at] = b;
                for (long i = 0; i < n; i++) {
                    const double value = u[i] - anchored * from[i];
                    y[to + i] += a * value, y_time[to + i] += b * value;
                    y_second[to + i] += c * value;
                }
            }
        }
}

void windows_move(const Windows *s, const Form *f, const double *x, const double *T, double *q)
{
    const long M = s->unknowns, n = f->joints, wide = PLACES * ORDERS;
    for (long k = 0; k < s->count; k++) {
        const long at = k * wide * M, to = k * wide * n;
        moved(s, f, k, PLACES, ORDERS, 0, s->weights + at, x, T[s->phase[k]], s->w + at,
              s->w_time + at, s->y + to, s->y_time + to, s->y_second + to);
        for (long p = s->own_begin; p < s->own_end; p++)
            for (int d = 0; d < ORDERS; d++)
                memcpy(q + (d * f->points + s->points[k * PLACES + p]) * n,
                       s->y + to + (p * ORDERS + d) * n, n * sizeof *q);
        if (s->inside)
            moved(s, f, k, 1, 1, ORDERS, s->jerks + k * M, x, T[s->phase[k]], s->e + k * M,
                  s->e_time + k * M, s->j + k * n, s->j_time + k * n, s->j_second + k * n);
    }
}

/* Cost: durations plus the integral of the weighted squared jerk, constant in an interval. */
void windows_cost(const Windows *s, const Form *f, const double *T, double *by_time,
                  double *gradient, double *total)
{
    const long M = s->unknowns, n = f->joints;
    for (long k = 0; s->inside && k < s->count; k++) {
        const double *j = s->j + k * n, *j_time = s->j_time + k * n, length = s->lengths[k];
        const double t = T[s->phase[k]];
        double squares = 0.0, change = 0.0;
        for (long i = 0; i < n; i++) {
            const double slope = 2.0 * f->jerk_weight[i] * j[i];
            squares += f->jerk_weight[i] * j[i] * j[i];
            change += slope * j_time[i];
            for (long m = 0; m < M; m++)
                gradient[s->columns[k * M + m] + i] += s->e[k * M + m] * slope * length * t;
        }
        *total += squares * length * t;
        by_time[s->phase[k]] += length * (change * t + squares);
    }
}

static void put(double *entries, const int *places, long count, const double *values)
{
    for (long k = 0; k < count; k++)
        if (places[k] >= 0) entries[places[k]] = values[k];
}

/* Jacobian: g_y W by the unknowns, g_y dy/dT by the duration. A torque rate is the difference
 * (SLOPES torques) of its three points, divided by the duration: the quotient rule applies.
 */
void windows_jacobian(const Windows *s, const Form *f, const double *T, const double *values,
                      const double *slopes, double *block, double *entries)
{
    const long M = s->unknowns, n = f->joints, R = f->rows, J = f->rated, size = R * n;
    const int rates = s->inside && J;
    const long begin = rates ? 0 : s->own_begin, end = rates ? PLACES : s->own_end;
    const long own = s->own_end - s->own_begin;
    double *by_time = block + PLACES * M * size; /* derivatives of limits by the duration [3,R] */
    double *difference = by_time + PLACES * R;   /* derivatives of torque differences [M,J,n] */
    for (long k = 0; k < s->count; k++) {
        const double *w = s->w + k * PLACES * ORDERS * M, t = T[s->phase[k]];
        const double *y_time = s->y_time + k * PLACES * ORDERS * n;
        for (long p = begin; p < end; p++) {
            const double *of = slopes + s->points[k * PLACES + p] * ORDERS * size;
            double *to = block + p * M * size;
            for (long m = 0; m < M; m++) {
                const double a = w[(p * ORDERS + 0) * M + m], b = w[(p * ORDERS + 1) * M + m];
                const double c = w[(p * ORDERS + 2) * M + m];
                for (long r = 0; r < size; r++)
                    to[m * size + r] = a * of[r] + b * of[size + r] + c * of[2 * size + r];
            }
            for (long r = 0; r < R; r++) {
                double sum = 0.0;
                for (int d = 0; d < ORDERS; d++)
                    for (long i = 0; i < n; i++)
                        sum += of[d * size + r * n + i] * y_time[(p * ORDERS + d) * n + i];
                by_time[p * R + r] = sum;
            }
        }
        for (long p = s->own_begin; p < s->own_end; p++) {
            const long at = k * own + p - s->own_begin;
            put(entries, s->limit + at * M * size, M * size, block + p * M * size);
            put(entries, s->limit_time + at * R, R, by_time + p * R);
            for (int d = 0; d < ORDERS; d++) {
                for (long m = 0; m < M; m++) {
                    const double a = w[(p * ORDERS + d) * M + m];
                    const int *places = s->bound + ((at * ORDERS + d) * M + m) * n;
                    for (long i = 0; i < n; i++)
                        if (places[i] >= 0) entries[places[i]] = a / f->bound_scale[d * n + i];
                }
                const int *places = s->bound_time + (at * ORDERS + d) * n;
                for (long i = 0; i < n; i++)
                    if (places[i] >= 0)
                        entries[places[i]] =
                            y_time[(p * ORDERS + d) * n + i] / f->bound_scale[d * n + i];
            }
        }
        for (long p = 0; rates && p < 2; p++) {
            const double factor = f->typical[s->phase[k]] / t, *slope = SLOPES[p];
            const int *points = s->points + k * PLACES;
            for (long j = 0; j < J; j++) {
                const long r = f->torque[j];
                const double scale = factor / f->rate_scale[j];
                /* The rate of dry friction at this end, as a torque difference in half an interval. */
                const long end = 2 * p, dry = r + f->friction;
                const double half = f->friction ? 0.5 * s->lengths[k] * t * scale : 0.0;
                for (long m = 0; m < M; m++)
                    for (long i = 0; i < n; i++)
                        difference[(m * J + j) * n + i] =
                            scale * (slope[0] * block[m * size + r * n + i] +
                                     slope[1] * block[(M + m) * size + r * n + i] +
                                     slope[2] * block[(2 * M + m) * size + r * n + i]) +
                            half * block[(end * M + m) * size + dry * n + i];
                const int place = s->rate_time[(k * 2 + p) * J + j];
                double change = 0.0;
                for (int l = 0; l < PLACES; l++)
                    change += slope[l] * (by_time[l * R + r] - values[points[l] * R + r] / t);
                change = scale * change + half * by_time[end * R + dry];
                if (place >= 0) entries[place] = change;
            }
            put(entries, s->rate + (k * 2 + p) * M * J * n, M * J * n, difference);
        }
        if (s->inside && s->jerk)
            for (long i = 0; i < n; i++) {
                for (long m = 0; m < M; m++) {
                    const int place = s->jerk[(k * M + m) * n + i];
                    if (place >= 0) entries[place] = s->e[k * M + m] / f->jerk_scale[i];
                }
                const int place = s->jerk_time[k * n + i];
                if (place >= 0) entries[place] = s->j_time[k * n + i] / f->jerk_scale[i];
            }
    }
}

/* Hessian of the Lagrangian, upper triangle; equation (3): part = W' G W, turned = G dy/dT, and
 * by_time = W' turned + (dW/dT)' g. For each order d, carried sums the blocks of row d times the
 * weights of their other order, so that the M^2 products with the weights of d are needed once.
 */
void windows_hessian(const Windows *s, const Form *f, const double *T, const double *values,
                     const double *slopes, const double *blocks, const double *gradient,
                     const double *of_rates, const double *of_jerks, double of_cost, double *work,
                     double *entries)
{
    const long M = s->unknowns, n = f->joints, nn = n * n, R = f->rows, J = f->rated;
    double *part = work, *turned = part + M * M * nn, *carried = turned + ORDERS * n;
    double *by_time = carried + M * nn;
    for (long k = 0; k < s->count; k++) {
        const double t = T[s->phase[k]];
        const long start = s->points[k * PLACES]; /* points of an interval are consecutive */
        const double *w = s->w + k * PLACES * ORDERS * M, *w1 = s->w_time + k * PLACES * ORDERS * M;
        double time_time = 0.0;
        memset(part, 0, M * M * nn * sizeof *part);
        memset(by_time, 0, M * n * sizeof *by_time);
        for (long p = s->own_begin; p < s->own_end; p++) {
            const long point = s->points[k * PLACES + p], at = (k * PLACES + p) * ORDERS * n;
            const double *y1 = s->y_time + at, *y2 = s->y_second + at;
            const double *slope = gradient + point * ORDERS * n;
            memset(turned, 0, ORDERS * n * sizeof *turned);
            for (int d = 0; d < ORDERS; d++) {
                /* Row d of blocks of G times weights: G is symmetric, so a block (one, two) with
                 * one < two also counts transposed. */
                int any = 0;
                memset(carried, 0, M * nn * sizeof *carried);
                for (long b = 0; b < f->pairs; b++) {
                    const double *block = blocks + (point * f->pairs + b) * nn;
                    const int one = f->first[b], two = f->second[b];
                    if (one == d) {
                        any = 1;
                        for (long m = 0; m < M; m++) {
                            const double a = w[(p * ORDERS + two) * M + m];
                            if (a != 0.0)
                                for (long i = 0; i < nn; i++) carried[m * nn + i] += a * block[i];
                        }
                        for (long i = 0; i < n; i++)
                            for (long j = 0; j < n; j++)
                                turned[d * n + i] += block[i * n + j] * y1[two * n + j];
                    }
                    if (two == d && one != d) {
                        any = 1;
                        for (long m = 0; m < M; m++) {
                            const double a = w[(p * ORDERS + one) * M + m];
                            if (a != 0.0)
                                for (long i = 0; i < n; i++)
                                    for (long j = 0; j < n; j++)
                                        carried[m * nn + i * n + j] += a * block[j * n + i];
                        }
                        for (long i = 0; i < n; i++)
                            for (long j = 0; j < n; j++)
                                turned[d * n + j] += block[i * n + j] * y1[one * n + i];
                    }
                }
                if (any)
                    for (long m = 0; m < M; m++) {
                        const double a = w[(p * ORDERS + d) * M + m];
                        if (a != 0.0)
                            for (long i = 0; i < M * nn; i++)
                                part[m * M * nn + i] += a * carried[i];
                    }
            }
            for (int d = 0; d < ORDERS; d++)
                for (long m = 0; m < M; m++) {
                    const double a = w[(p * ORDERS + d) * M + m];
                    const double b = w1[(p * ORDERS + d) * M + m];
                    for (long i = 0; i < n; i++)
                        by_time[m * n + i] += a * turned[d * n + i] + b * slope[d * n + i];
                }
            for (long i = 0; i < ORDERS * n; i++)
                time_time += y1[i] * turned[i] + slope[i] * y2[i];
        }
        if (s->inside) {
            const double *e = s->e + k * M, *e1 = s->e_time + k * M, length = s->lengths[k];
            const double *j = s->j + k * n, *j1 = s->j_time + k * n, *j2 = s->j_second + k * n;
            for (long i = 0; i < n; i++) {
                const double weight = 2.0 * of_cost * f->jerk_weight[i], by = weight * j[i];
                for (long m = 0; m < M; m++) {
                    for (long o = 0; o < M; o++)
                        part[(m * M + o) * nn + i * n + i] += weight * length * t * e[m] * e[o];
                    by_time[m * n + i] += e[m] * length * (by + t * weight * j1[i]) +
                                          e1[m] * (by * length * t + of_jerks[start * n + i]);
                }
                time_time += length * (2.0 * by * j1[i] + t * (weight * j1[i] * j1[i] + by * j2[i])) +
                             of_jerks[start * n + i] * j2[i];
            }
            /* A rate is D / T: the part of D is in G and g, the quotient's part follows: -D_u / T by
             * unknowns, -2 D_T / T + 2 D / T^2 by the duration. */
            for (long p = 0; J && p < PLACES; p++) {
                const long point = s->points[k * PLACES + p];
                const double *of = slopes + point * ORDERS * R * n;
                const double *y1 = s->y_time + (k * PLACES + p) * ORDERS * n;
                for (int d = 0; d < ORDERS; d++)
                    for (long i = 0; i < n; i++) {
                        double sum = 0.0;
                        for (long r = 0; r < J; r++)
                            sum += (SLOPES[0][p] * of_rates[start * J + r] +
                                    SLOPES[1][p] * of_rates[(start + 1) * J + r]) *
                                   of[(d * R + f->torque[r]) * n + i];
                        for (long m = 0; m < M; m++)
                            by_time[m * n + i] -= w[(p * ORDERS + d) * M + m] * sum / t;
                        time_time -= 2.0 * sum * y1[d * n + i] / t;
                    }
                for (long r = 0; r < J; r++)
                    time_time += 2.0 *
                                 (SLOPES[0][p] * of_rates[start * J + r] +
                                  SLOPES[1][p] * of_rates[(start + 1) * J + r]) *
                                 values[point * R + f->torque[r]] / (t * t);
            }
        }
        const int *places = s->hessian + k * M * M * nn;
        for (long i = 0; i < M * M * nn; i++)
            if (places[i] >= 0) entries[places[i]] += part[i];
        places = s->hessian_time + k * M * n;
        for (long i = 0; i < M * n; i++) entries[places[i]] += by_time[i];
        entries[s->time_time[k]] += time_time;
    }
}
