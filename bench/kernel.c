/* The AOI's recursion in its normal course (enabled, initialised, S > 0, no bleed) as fast as C does it on this
   machine: bench/kernel.py compiles it and calls it through ctypes. Numbers, order and arrays are those of softplc's
   kernels, which must give the same bits. Not shipped. */
#include <stddef.h>

#define OUT double *restrict
#define IN const double *restrict

/* One scan of n axes, structure of arrays: the compiler makes vector instructions of it. */
static void steps(ptrdiff_t n, OUT x_pred, OUT y_res, OUT S_, OUT x_dot_pred, OUT P0, OUT P1, OUT P2, OUT P3, OUT K0_,
                  OUT K1_, OUT dt_s, OUT y, OUT y_dot, IN q_x, IN q_x_dot, IN r_x, IN x, IN dt)
{
    for (ptrdiff_t i = 0; i < n; i++) {
        double d = dt[i] / 1000.0;
        double position = x_pred[i] + d * x_dot_pred[i];
        double x_cov1 = P1[i] + d * P3[i], x_cov2 = P2[i] + d * P3[i];
        double x_cov0 = (P0[i] + d * P2[i]) + d * x_cov1;
        x_cov0 = x_cov0 + q_x[i];
        double x_cov3 = P3[i] + q_x_dot[i];
        double e = x[i] - position, S = x_cov0 + r_x[i];
        double K0 = x_cov0 / S, K1 = x_cov2 / S, rest = 1.0 - K0;
        position = position + K0 * e;
        double velocity = x_dot_pred[i] + K1 * e;
        P0[i] = rest * x_cov0;
        P1[i] = P2[i] = rest * x_cov1;
        P3[i] = x_cov3 - K1 * x_cov1;
        x_pred[i] = y[i] = position;
        x_dot_pred[i] = y_dot[i] = velocity;
        y_res[i] = e, S_[i] = S, K0_[i] = K0, K1_[i] = K1, dt_s[i] = d;
    }
}

/* `scans` scans: state [13][n] and tuning [5][n] as softplc has them, x one of four rows [4][n] in turn, dt [n]. */
void live(ptrdiff_t scans, ptrdiff_t n, double *s, const double *t, const double *x, const double *dt)
{
    for (ptrdiff_t k = 0; k < scans; k++)
        steps(n, s, s + n, s + 2 * n, s + 3 * n, s + 4 * n, s + 5 * n, s + 6 * n, s + 7 * n, s + 8 * n, s + 9 * n,
              s + 10 * n, s + 11 * n, s + 12 * n, t, t + n, t + 2 * n, x + (k & 3) * n, dt);
}

/* A recording x [scans][n] with the same dt [scans] for all axes; tracks y, y_dot [2][scans][n], as softplc keeps them. */
void replay_many(ptrdiff_t scans, ptrdiff_t n, double *s, const double *t, IN x, IN dt, double *row, OUT tracks)
{
    for (ptrdiff_t k = 0; k < scans; k++) {
        for (ptrdiff_t i = 0; i < n; i++)
            row[i] = dt[k];
        live(1, n, s, t, x + k * n, row);
        for (ptrdiff_t i = 0; i < n; i++)
            tracks[k * n + i] = s[11 * n + i];
        for (ptrdiff_t i = 0; i < n; i++)
            tracks[(scans + k) * n + i] = s[12 * n + i];
    }
}

/* One axis, its state in registers. */
void replay_one(ptrdiff_t scans, double q_x, double q_x_dot, double r_x, IN x, IN dt, OUT y, OUT y_dot)
{
    double position = x[0], velocity = 0, P0 = 1, P1 = 0, P2 = 0, P3 = 10;
    for (ptrdiff_t k = 0; k < scans; k++) {
        double d = dt[k] / 1000.0;
        position = position + d * velocity;
        double x_cov1 = P1 + d * P3, x_cov2 = P2 + d * P3;
        double x_cov0 = (P0 + d * P2) + d * x_cov1;
        x_cov0 = x_cov0 + q_x;
        double x_cov3 = P3 + q_x_dot, e = x[k] - position, S = x_cov0 + r_x;
        double K0 = x_cov0 / S, K1 = x_cov2 / S, rest = 1.0 - K0;
        y[k] = position = position + K0 * e;
        y_dot[k] = velocity = velocity + K1 * e;
        P0 = rest * x_cov0;
        P1 = P2 = rest * x_cov1;
        P3 = x_cov3 - K1 * x_cov1;
    }
}
