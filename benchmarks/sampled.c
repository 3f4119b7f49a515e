/* A simpler model than millax's as a plain scalar loop: hard gates, and the force sampled in the middle of each step.
 *
 * 2-DOF structure by its exact transition, second-order chip thickness over `passes` remembered passes, fractional law, a
 * straight border x = 0. First order in the step where a tooth meets the border. The tooth angles repeat every tooth period,
 * so their sines and cosines are tables. */
#include <math.h>
#include <stdlib.h>

void sampled(int steps_per_tooth, int teeth, int passes, long steps, double dt, double speed, double feed, double radius,
             double k0a, double hs, double r, double kr, const double *half, const double *half_in, const double *whole,
             const double *whole_in, double *force_out, double *move_out)
{
    /* half, whole: 4 x 4 transition over half a step and a step; *_in: 4 x 2 input matrices. State (x, y, vx, vy). */
    const int kept = passes * steps_per_tooth;
    double *past = calloc((size_t)kept * 4, sizeof *past);
    double *cosine = malloc((size_t)teeth * steps_per_tooth * sizeof *cosine);
    double *sine = malloc((size_t)teeth * steps_per_tooth * sizeof *sine);
    for (int j = 0; j < steps_per_tooth; j++)
        for (int i = 0; i < teeth; i++) {
            double phi = (j + 0.5) * dt * speed + 2 * M_PI * i / teeth;
            cosine[j * teeth + i] = cos(phi);
            sine[j * teeth + i] = sin(phi);
        }
    double z[4] = {0, 0, 0, 0}, fx = 0, fy = 0;
    const double feed_per_tooth = feed * dt * steps_per_tooth;
    int slot = 0, j = 0;
    for (long step = 0; step < steps; step++) {
        double m[4];
        for (int a = 0; a < 4; a++)
            m[a] = half[4 * a] * z[0] + half[4 * a + 1] * z[1] + half[4 * a + 2] * z[2] + half[4 * a + 3] * z[3]
                   + half_in[2 * a] * fx + half_in[2 * a + 1] * fy;
        const double xc = -radius + feed * (step + 0.5) * dt + m[0];
        fx = fy = 0;
        for (int i = 0; i < teeth; i++) {
            const double c = cosine[j * teeth + i], s = sine[j * teeth + i];
            double h = 1;
            int at = slot;
            for (int k = 1; k <= passes; k++) {
                at -= steps_per_tooth;
                if (at < 0) at += kept;
                const double *q = past + 4 * at;
                const double dx = k * feed_per_tooth + m[0] - q[0], dy = m[1] - q[1];
                const double n = c * dx - s * dy, e = -s * dx - c * dy;
                const double v = c * (feed + q[2]) - s * q[3];
                const double g = n + e * (e / (2 * radius) - v / (speed * radius));
                if (g < h) h = g;
            }
            if (c > 0) {
                const double x = (xc + radius * c) / c;
                if (x < h) h = x;
            }
            if (h > 0) {
                const double u = h / hs, t = k0a * hs * (u + r * u * u) / (1 + u);
                fx += t * (s - kr * c);
                fy += t * (c + kr * s);
            }
        }
        double w[4];
        for (int a = 0; a < 4; a++) {
            past[4 * slot + a] = m[a];
            w[a] = whole[4 * a] * z[0] + whole[4 * a + 1] * z[1] + whole[4 * a + 2] * z[2] + whole[4 * a + 3] * z[3]
                   + whole_in[2 * a] * fx + whole_in[2 * a + 1] * fy;
        }
        for (int a = 0; a < 4; a++) z[a] = w[a];
        force_out[2 * step] = fx;
        force_out[2 * step + 1] = fy;
        move_out[2 * step] = m[0];
        move_out[2 * step + 1] = m[1];
        if (++slot == kept) slot = 0;
        if (++j == steps_per_tooth) j = 0;
    }
    free(past);
    free(cosine);
    free(sine);
}
