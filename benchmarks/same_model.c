/* The model of millax as a plain scalar loop, one time step after the other: the yardstick of `make bench`, and an oracle
 * for the engine, with which it shares equations but no line.
 *
 * Per step, displacement and mean force are iterated until they agree, instead of in sweeps over whole tooth periods. In
 * the order of millax/_math.py, _forces.py, _chip.py, _contact.py. What a careful programmer would do is done: sizes known
 * at compile time, tables for all that repeats every tooth period, teeth out of contact left at the first pass that shows
 * it, no border arithmetic far from a border, no square root for teeth behind the cut, and a good first guess of the force. */
#include <math.h>
#include <stdlib.h>

#ifndef TEETH /* set by the compiler's command line */
#define TEETH 4
#define PASSES 3
#define BORDERS 1
#define STATES 4
#define STEPS_PER_TOOTH 40
#endif
#define TINY 1e-30
#define MOST_ITERATIONS 100

typedef struct {
    long steps;
    double step_angle, radius, depth, start_x, start_y, feed_rate, feed_per_tooth, tip_speed;
    double k0, hs, r, kr, width;
    double tolerance;                        /* the iteration ends where it moves the tool by less [m] */
    double normals[2 * BORDERS + 1], offsets[BORDERS + 1];
    double middle[4 * STATES], middle_in[8]; /* (x, y, vx, vy) in the middle of a step, from its start and its force */
    double whole[STATES * STATES], whole_in[2 * STATES];
} Case;

typedef struct { double before, after, steepness, bulge, nx, ny; int exits; } Border;
typedef struct { double cosine, sine; Border border[BORDERS + 1]; } Place; /* a tooth in one step of the tooth period */
typedef struct { double x, y, vx, vy; } Past; /* from an earlier pass to now but for u(t) [m]; its velocity over Omega R */
typedef struct { double tangential, thickness, turn; } Contact;

/* _math.py */

static inline double positive_part(double x, double width)
{
    if (x >= width) return x;
    if (x <= -width) return 0;
    return (x + width) * (x + width) / (4 * width + TINY);
}

static inline double half_change(double change, double width) { return sqrt(width * width + change * change + TINY); }

static inline double preferred(double a, double b, double width)
{
    const double t = 2 * (a - b) / (width + 1e-15) + 0.5;
    if (t <= 0) return 0;
    if (t >= 1) return 1;
    return t * t * (3 - 2 * t);
}

/* _forces.py: the fractional law */

static inline double work(const Case *c, double low, double high)
{
    const double u = low / c->hs, step = (high - low) / c->hs;
    return c->k0 * c->hs * c->hs * (c->r * step * (u + step / 2) + (1 - c->r) * (step - log1p(step / (1 + u))));
}

/* _chip.py: gap and rate of the pass that leaves the least. Returns 0 for a tooth out of contact, 1 for one that may cut. */

static inline int thickness(const Case *c, const Place *p, const Past *past, double x, double y, double *gap, double *rate)
{
    const double n = p->cosine, s = p->sine;
    double least = 0;
    for (int k = 0; k < PASSES; k++) {
        const double dx = x + past[k].x, dy = y + past[k].y;
        const double across = -s * dx - n * dy, change = fabs(across) * (c->step_angle / 2);
        const double g = fabs(across) < c->radius
            ? n * dx - s * dy + across * (across / (2 * c->radius) - (n * past[k].vx - s * past[k].vy)) : c->radius;
        /* So far out of contact that any pass preferred to this one, or blended with it, is out of contact too. */
        if (g < -change - 3 * c->width) return 0;
        const double score = g > change + c->width ? g : positive_part(g, half_change(change, c->width));
        if (k == 0) {
            least = score, *gap = g, *rate = across;
            continue;
        }
        const double weight = preferred(least, score, c->width);
        if (weight == 0) continue;
        least += weight * (score - least), *gap += weight * (g - *gap), *rate += weight * (across - *rate);
    }
    return 1;
}

/* _contact.py */

typedef struct { double low, high, half; } Range; /* of the thickness in a step */

static inline Range range(double gap, double change, double width)
{
    const double half = half_change(change, width / 2);
    return (Range){positive_part(gap - half, width / 2), positive_part(gap + half, width / 2), half};
}

static inline double mean_thickness(Range r) { return (r.high - r.low) * (r.high + r.low) / (4 * r.half); }

static inline double mean_force(const Case *c, Range r) { return work(c, r.low, r.high) / (2 * r.half); }

/* The distance from the nearest border at both ends of the step, as a thickness; 0 where all are too far to matter. */
static inline int nearest(const Case *c, const Place *p, double x, double y, double h, double *start, double *end)
{
    int near = 0;
    for (int b = 0; b < BORDERS; b++) {
        const Border *q = p->border + b;
        const double shift = q->nx * x + q->ny * y;
        double from = (q->before - shift) * q->steepness, to = (q->after - shift) * q->steepness;
        if (q->exits) from += h, to += h;
        near |= fmin(from, to) < h + fabs(q->bulge) + 2 * c->width + 1e-12;
        const double length = fabs(to - from) + 1e-12, high = fmax(from, to) + 2 * q->bulge / 3;
        const double part = fmin(fmax(high / length, 0), 1), raised = q->bulge * part * (2 - 4 * part / 3);
        from += raised, to += raised;
        *start = b ? *start - positive_part(*start - from, c->width) : from;
        *end = b ? *end - positive_part(*end - to, c->width) : to;
    }
    return near;
}

static inline Contact crossing(const Case *c, const Place *p, double x, double y, double gap, double rate)
{
    const double change = rate * c->step_angle / 2;
    const Range whole = range(gap, change, c->width);
    const double h = mean_thickness(whole);
    double start = 0, end = 0;
    if (h == 0) return (Contact){0, 0, 0};
    if (!nearest(c, p, x, y, h, &start, &end)) return (Contact){mean_force(c, whole), h, 0};
    const double length = sqrt((end - start) * (end - start) + c->width * c->width + 1e-24), middle = (start + end) / 2;
    const double low = middle - length / 2, high = middle + length / 2;
    if (high <= 0) return (Contact){0, 0, 0};
    const double ramp_low = fmin(fmax(low, 0), h), ramp_high = fmin(high, h);
    const double full_low = fmax(low, h), full_high = fmax(high, h), full = full_high - full_low;
    const double area = (ramp_high * ramp_high - ramp_low * ramp_low) / 2 + h * full;
    const double moment = (ramp_high * ramp_high * ramp_high - ramp_low * ramp_low * ramp_low) / 3
                          + h * full * ((full_high + full_low) / 2);
    const double turn = (moment / area - middle) * (end - start) / (length * length) * c->step_angle;
    const double plateau = full > 0 ? mean_force(c, range(gap + rate * turn, change * full / length, c->width)) * full : 0;
    return (Contact){(work(c, ramp_low, ramp_high) + plateau) / length, area / length, turn};
}

static void fill(const Case *c, Place (*places)[TEETH])
{
    for (int j = 0; j < STEPS_PER_TOOTH; j++)
        for (int i = 0; i < TEETH; i++) {
            Place *p = &places[j][i];
            const double phi = (j + 0.5) * c->step_angle + 2 * M_PI * i / TEETH, advance = c->feed_per_tooth / STEPS_PER_TOOTH;
            p->cosine = cos(phi), p->sine = sin(phi);
            for (int b = 0; b < BORDERS; b++) {
                const double nx = c->normals[2 * b], ny = c->normals[2 * b + 1];
                const double across = nx * p->cosine - ny * p->sine;
                double distance[2];
                for (int end = 0; end < 2; end++) {
                    const double angle = phi + (end - 0.5) * c->step_angle;
                    distance[end] = c->offsets[b] - nx * (c->start_x + advance * (j + end)) - ny * c->start_y
                                    - c->radius * (nx * cos(angle) - ny * sin(angle));
                }
                p->border[b] = (Border){.before = distance[0], .after = distance[1], .nx = nx, .ny = ny,
                                        .steepness = 1 / sqrt(across * across + 1e-6), .exits = across > 0};
                p->border[b].bulge = -c->radius * across * p->border[b].steepness * c->step_angle * c->step_angle / 8;
            }
        }
}

/* Traces as in millax.Simulation: force (steps, 2), displacement (steps, 2), chip thickness (steps, TEETH). Returns how many
 * times the force of a step was computed, on average. */
double same_model(const Case *given, double *restrict force, double *restrict displacement, double *restrict chip)
{
    const Case own = *given, *c = &own; /* that no store into a trace can change: its quotients are taken once */
    enum { N = STEPS_PER_TOOTH, KEPT = PASSES * STEPS_PER_TOOTH };
    Place (*places)[TEETH] = malloc(sizeof(Place[N][TEETH]));
    double (*motion)[4] = calloc(KEPT, sizeof *motion);
    double z[STATES] = {0}, fx = 0, fy = 0;
    long evaluations = 0;
    int slot = 0, j = 0;
    fill(c, places);
    for (long step = 0; step < c->steps; step++) {
        const long period = step / N;
        /* First guess: the force one tooth period ago, and what the step before differed from its own by. */
        if (period && step > N) {
            const double *before = force + 2 * (step - N);
            fx += before[0] - before[-2], fy += before[1] - before[-1];
        }
        Past past[PASSES];
        int at = slot;
        for (int k = 0; k < PASSES; k++) {
            at -= N;
            if (at < 0) at += KEPT;
            const double *q = motion[at];
            past[k] = (Past){.x = (k + 1) * c->feed_per_tooth - q[0], .y = -q[1],
                             .vx = (c->feed_rate + q[2]) / c->tip_speed, .vy = q[3] / c->tip_speed};
        }
        double free[4];
        for (int a = 0; a < 4; a++) {
            free[a] = 0;
            for (int b = 0; b < STATES; b++) free[a] += c->middle[a * STATES + b] * z[b];
        }
        for (int iteration = 0; iteration < MOST_ITERATIONS; iteration++) {
            const double x = free[0] + c->middle_in[0] * fx + c->middle_in[1] * fy;
            const double y = free[1] + c->middle_in[2] * fx + c->middle_in[3] * fy;
            double sum_x = 0, sum_y = 0;
            for (int i = 0; i < TEETH; i++) {
                const Place *p = &places[j][i];
                double gap, rate, *h = chip + step * TEETH + (i + (TEETH - 1) * period) % TEETH;
                *h = 0;
                if (!thickness(c, p, past, x, y, &gap, &rate)) continue;
                const Contact t = crossing(c, p, x, y, gap, rate);
                const double tangential = c->depth * t.tangential, radial = c->kr * tangential;
                const double n = p->cosine - p->sine * t.turn, s = p->sine + p->cosine * t.turn;
                sum_x += tangential * s - radial * n;
                sum_y += tangential * n + radial * s;
                *h = t.thickness;
            }
            const double dx = sum_x - fx, dy = sum_y - fy;
            const double moved = fabs(c->middle_in[0] * dx + c->middle_in[1] * dy) + fabs(c->middle_in[2] * dx + c->middle_in[3] * dy);
            fx = sum_x, fy = sum_y;
            evaluations++;
            if (moved <= c->tolerance) break;
        }
        for (int a = 0; a < 4; a++) motion[slot][a] = free[a] + c->middle_in[2 * a] * fx + c->middle_in[2 * a + 1] * fy;
        double next[STATES];
        for (int a = 0; a < STATES; a++) {
            next[a] = c->whole_in[2 * a] * fx + c->whole_in[2 * a + 1] * fy;
            for (int b = 0; b < STATES; b++) next[a] += c->whole[a * STATES + b] * z[b];
        }
        for (int a = 0; a < STATES; a++) z[a] = next[a];
        force[2 * step] = fx, force[2 * step + 1] = fy;
        displacement[2 * step] = motion[slot][0], displacement[2 * step + 1] = motion[slot][1];
        if (++slot == KEPT) slot = 0;
        if (++j == N) {
            j = 0;
            for (int s = 0; s < N; s++) /* the borders come nearer by one feed per tooth */
                for (int i = 0; i < TEETH; i++)
                    for (int b = 0; b < BORDERS; b++) {
                        Border *q = places[s][i].border + b;
                        q->before -= q->nx * c->feed_per_tooth, q->after -= q->nx * c->feed_per_tooth;
                    }
        }
    }
    free(places);
    free(motion);
    return (double)evaluations / c->steps;
}
