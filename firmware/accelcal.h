/* accelcal.h: calibration of a triaxial accelerometer on a microcontroller, in C99 without heap or floats.
 *
 * The procedure of Farago, Maczak, Gingl 2024 ("F"), with the same bits as profile `paper` of accelcal:
 * samples come in one by one; windows of 5 s that are still are offered to nine subsets of two points, and
 * then to nine more for control; a descent of 50 iterations finds scales, misalignment and offsets.
 *
 *     static struct accelcal held;
 *     static int32_t points[ACCELCAL_POINTS][3], p[ACCELCAL_PARAMETERS];
 *
 *     accelcal_init(&held, 5 * 25, 256, 2048);          25 Hz, 256 counts per g, +-8 g
 *     accelcal_add(&held, sample);                      each sample, {x, y, z} in counts
 *     if (accelcal_points(&held, ACCELCAL_FIT, points) == ACCELCAL_POINTS
 *         && accelcal_fit(points, p)) ...
 *
 * Numbers in fixed point are int32_t with 29 fraction bits: ACCELCAL_ONE is 1, or 1 g. A calibrated sample is
 *
 *     ax = kxx (x + ox)
 *     ay = kyx (x + ox) + kyy (y + oy)
 *     az = kzx (x + ox) + kzy (y + oy) + kzz (z + oz)     (F eq. 7-9, which call these kxy, kxz, kyz)
 *
 * Define ACCELCAL_WIDE before including this file for counts of 32 bits instead of 16.
 *
 * Nothing is allocated: the caller owns all memory. Needed of the compiler: 8-bit bytes, two's complement,
 * and a right shift of negative numbers that keeps their sign.
 */
#ifndef ACCELCAL_H
#define ACCELCAL_H

#include <stdbool.h>
#include <stdint.h>

#ifdef ACCELCAL_WIDE
typedef int32_t accelcal_count; /* a sample of one axis [counts] */
typedef int64_t accelcal_sum;   /* of the samples of a window [counts] */
#define ACCELCAL_SUM_MAX INT64_MAX
#else
typedef int16_t accelcal_count;
typedef int32_t accelcal_sum;
#define ACCELCAL_SUM_MAX INT32_MAX
#endif

typedef char accelcal_right_shifts_keep_the_sign[((int32_t)-1 >> 1) == -1 ? 1 : -1];

#define ACCELCAL_FRACTION_BITS 29
#define ACCELCAL_ONE ((int32_t)1 << ACCELCAL_FRACTION_BITS)

enum {
    ACCELCAL_SUBSETS = 9,    /* x, y, z near -1, 0, 1 g (F eq. 10) */
    ACCELCAL_PER_SUBSET = 2, /* points in each */
    ACCELCAL_POINTS = ACCELCAL_SUBSETS * ACCELCAL_PER_SUBSET,
    ACCELCAL_ITERATIONS = 50,
    ACCELCAL_PARAMETERS = 9, /* kxx kyy kzz kyx kzx kzy, without a unit; ox oy oz [g] */
    ACCELCAL_STEP = 5369     /* h, 1e-5 in fixed point (F eq. 13) */
};

enum accelcal_set { ACCELCAL_FIT, ACCELCAL_CONTROL }; /* what is fitted, and what a fit is held against */

/* What became of a window. */
enum accelcal_fate {
    ACCELCAL_OPEN,        /* it goes on */
    ACCELCAL_UNUSABLE,    /* a sample was not measured, or was at the end of the range */
    ACCELCAL_MOVING,      /* x changed by 0.12 g or more */
    ACCELCAL_IMPLAUSIBLE, /* still, but its mean is 0.5 g or shorter, or 1.5 g or longer */
    ACCELCAL_NOT_TAKEN,   /* still, but within 0.2 g of a point, or there is no room in its subsets */
    ACCELCAL_TAKEN_TO_FIT,
    ACCELCAL_TAKEN_TO_CONTROL
};

/* All that is kept between samples. */
struct accelcal {
    uint32_t one_g;                      /* sum of a window's counts that 1 g makes */
    uint32_t spread_limit;               /* a window is moving if x changes by as much as that [counts] */
    accelcal_sum full_scale;             /* [counts] */
    uint16_t length;                     /* of a window [samples] */
    uint16_t filled;                     /* samples in the window so far */
    bool usable;                         /* whether all of them are */
    accelcal_count low, high;            /* their smallest and largest x [counts] */
    accelcal_sum sums[3];                /* of them [counts] */
    uint8_t number[2][ACCELCAL_SUBSETS]; /* points in each subset of each set */
    accelcal_sum held[2][ACCELCAL_SUBSETS][ACCELCAL_PER_SUBSET][3]; /* sums of their windows [counts] */
};

/* ---- Windows ---- */

/* Begin a new window, without what is left of the last one: for samples that do not follow on the last. */
static inline void accelcal_break(struct accelcal *held)
{
    held->filled = 0;
    held->usable = true;
    held->low = held->high = 0;
    held->sums[0] = held->sums[1] = held->sums[2] = 0;
}

/* Begin, without any point.
 *
 * length: samples in a window; 5 s (F section II.B.1), to the nearest sample, halves to the even one.
 * counts_per_g: as the data sheet has it; what the sensor really has is what the fit finds.
 * full_scale: counts at the end of the range, such as 2048 for 8 g at 256 counts per g; samples there are
 *     not used. 0: unknown, all are used.
 *
 * Returns whether it can work with that: length * counts_per_g must be 1 or more and fit 32 bits.
 */
static inline bool accelcal_init(struct accelcal *held, uint16_t length, uint32_t counts_per_g,
                                 accelcal_sum full_scale)
{
    uint8_t subset;
    if (length == 0 || counts_per_g == 0 || counts_per_g > UINT32_MAX / length)
        return false;
    held->one_g = length * counts_per_g;
    held->spread_limit = (uint32_t)((3 * (uint64_t)counts_per_g + 24) / 25); /* 0.12 g, rounded up */
    held->full_scale = full_scale ? full_scale : ACCELCAL_SUM_MAX;
    held->length = length;
    for (subset = 0; subset < ACCELCAL_SUBSETS; subset++)
        held->number[ACCELCAL_FIT][subset] = held->number[ACCELCAL_CONTROL][subset] = 0;
    accelcal_break(held);
    return true;
}

/* ---- Points (F section II.B.1) ---- */

static inline uint64_t accelcal_magnitude(int64_t value)
{
    return value < 0 ? (uint64_t)-value : (uint64_t)value;
}

/* Compare the length of a vector of sums with numerator / denominator g, exactly.
 *
 * The squares of numbers below 2**36 are added in two parts, in units of 2**32 and of 1.
 *
 * Returns -1 if it is shorter, 0 if it is as long, 1 if it is longer.
 */
static inline int8_t accelcal_compare(const struct accelcal *held, const int64_t vector[3], uint8_t numerator,
                                      uint8_t denominator)
{
    const uint64_t limit = numerator * (uint64_t)held->one_g;
    uint64_t sides[4], high[2] = {0, 0}, low[2] = {0, 0}; /* of the vector, and of the limit */
    uint8_t index;
    for (index = 0; index < 3; index++) {
        sides[index] = denominator * accelcal_magnitude(vector[index]);
        if (sides[index] > limit)
            return 1;
    }
    sides[3] = limit;
    for (index = 0; index < 4; index++) {
        const uint64_t upper = sides[index] >> 32, lower = sides[index] & UINT32_MAX, square = lower * lower;
        low[index / 3] += square & UINT32_MAX;
        high[index / 3] += (square >> 32) + 2 * upper * lower + (upper * upper << 32);
    }
    high[0] += low[0] >> 32;
    high[1] += low[1] >> 32;
    low[0] &= UINT32_MAX;
    low[1] &= UINT32_MAX;
    if (high[0] == high[1])
        return (int8_t)((low[0] > low[1]) - (low[0] < low[1]));
    return high[0] < high[1] ? -1 : 1;
}

/* Where a sum lies (F eq. 10): 0, 1, 2 for -1.25..-0.75, -0.25..0.25, 0.75..1.25 g; 3 for elsewhere. */
static inline uint8_t accelcal_level(const struct accelcal *held, accelcal_sum sum)
{
    const int64_t one_g = held->one_g, four = 4 * (int64_t)sum;
    uint8_t level;
    for (level = 0; level < 3; level++) {
        const int64_t middle = 4 * (level - 1) * one_g;
        if (middle - one_g <= four && four <= middle + one_g)
            break;
    }
    return level;
}

/* Put the window's sums into the first subset of a set, in the order x, y, z, that has room for them. */
static inline bool accelcal_offer(struct accelcal *held, enum accelcal_set set)
{
    uint8_t axis;
    for (axis = 0; axis < 3; axis++) {
        const uint8_t level = accelcal_level(held, held->sums[axis]), subset = (uint8_t)(3 * axis + level);
        if (level < 3 && held->number[set][subset] < ACCELCAL_PER_SUBSET) {
            accelcal_sum *place = held->held[set][subset][held->number[set][subset]++];
            place[0] = held->sums[0];
            place[1] = held->sums[1];
            place[2] = held->sums[2];
            return true;
        }
    }
    return false;
}

/* Whether the window's mean is less than 0.2 g from a point of either set. */
static inline bool accelcal_near_a_point(const struct accelcal *held)
{
    uint8_t set, subset, index, axis;
    for (set = 0; set < 2; set++)
        for (subset = 0; subset < ACCELCAL_SUBSETS; subset++)
            for (index = 0; index < held->number[set][subset]; index++) {
                int64_t apart[3];
                for (axis = 0; axis < 3; axis++)
                    apart[axis] = (int64_t)held->sums[axis] - held->held[set][subset][index][axis];
                if (accelcal_compare(held, apart, 1, 5) < 0)
                    return true;
            }
    return false;
}

/* What becomes of a full window. */
static inline enum accelcal_fate accelcal_judge(struct accelcal *held)
{
    const int64_t sums[3] = {held->sums[0], held->sums[1], held->sums[2]};
    if (!held->usable)
        return ACCELCAL_UNUSABLE;
    if ((uint32_t)held->high - (uint32_t)held->low >= held->spread_limit)
        return ACCELCAL_MOVING;
    if (accelcal_compare(held, sums, 1, 2) <= 0 || accelcal_compare(held, sums, 3, 2) >= 0)
        return ACCELCAL_IMPLAUSIBLE;
    if (accelcal_near_a_point(held))
        return ACCELCAL_NOT_TAKEN;
    if (accelcal_offer(held, ACCELCAL_FIT))
        return ACCELCAL_TAKEN_TO_FIT;
    return accelcal_offer(held, ACCELCAL_CONTROL) ? ACCELCAL_TAKEN_TO_CONTROL : ACCELCAL_NOT_TAKEN;
}

/* A sample has taken its place in the window: what became of the window, if that was its last. */
static inline enum accelcal_fate accelcal_counted(struct accelcal *held)
{
    enum accelcal_fate fate;
    if (++held->filled < held->length)
        return ACCELCAL_OPEN;
    fate = accelcal_judge(held);
    accelcal_break(held);
    return fate;
}

/* Take a sample in [counts]; says what became of the window that it completes, else ACCELCAL_OPEN. */
static inline enum accelcal_fate accelcal_add(struct accelcal *held, const accelcal_count sample[3])
{
    uint8_t axis;
    if (held->filled == 0)
        held->low = held->high = sample[0];
    if (sample[0] < held->low)
        held->low = sample[0];
    if (sample[0] > held->high)
        held->high = sample[0];
    for (axis = 0; axis < 3; axis++) {
        if (sample[axis] <= -held->full_scale || sample[axis] >= held->full_scale - 1)
            held->usable = false;
        held->sums[axis] += sample[axis];
    }
    return accelcal_counted(held);
}

/* The same for a sample that was not measured, but takes its place: it makes its window unusable. */
static inline enum accelcal_fate accelcal_add_unmeasured(struct accelcal *held)
{
    held->usable = false;
    return accelcal_counted(held);
}

/* Means of the points of a set, subset by subset, in raw g in fixed point, each below 1.5 g.
 *
 * Returns how many there are; a set of ACCELCAL_POINTS is full.
 */
static inline uint8_t accelcal_points(const struct accelcal *held, enum accelcal_set set, int32_t points[][3])
{
    const int64_t one_g = held->one_g;
    uint8_t subset, index, axis, number = 0;
    for (subset = 0; subset < ACCELCAL_SUBSETS; subset++)
        for (index = 0; index < held->number[set][subset]; index++, number++)
            for (axis = 0; axis < 3; axis++) {
                /* sum * ONE / one_g, rounded half up; twice 1.5 g keeps the dividend positive */
                const int64_t sum = held->held[set][subset][index][axis] + 2 * one_g;
                const uint64_t dividend = 2 * (uint64_t)sum * (uint64_t)ACCELCAL_ONE + (uint64_t)one_g;
                points[number][axis] = (int32_t)(dividend / (2 * (uint64_t)one_g)) - 2 * ACCELCAL_ONE;
            }
    return number;
}

/* ---- The fit (F section II.C) ---- */

/* A point under some parameters: u = v + o, K u, a, |a|^2 - 1 before and after it is rounded. */
struct accelcal_state {
    int32_t shifted[3];    /* 29 fraction bits, as all int32_t here */
    int64_t products[3];   /* 58 fraction bits */
    int32_t calibrated[3];
    int64_t square;        /* 58 fraction bits */
    int32_t residual;
};

/* Row and column in K of the first six parameters. */
static const uint8_t accelcal_row[6] = {0, 1, 2, 1, 2, 2}, accelcal_column[6] = {0, 1, 2, 0, 0, 1};

/* Drop 29 fraction bits, rounding half up; says whether the result lies between -limit and limit, exclusive.
 *
 * The limit is a multiple of 8. The result is put together of the upper 32 bits and the 3 below, since some
 * compilers shift 64 bits by a loop.
 */
static inline bool accelcal_narrow(int64_t value, int32_t limit, int32_t *narrowed)
{
    const int64_t raised = value + ACCELCAL_ONE / 2;
    const int32_t upper = (int32_t)(raised >> 32);
    if (upper < -(limit / 8) || upper >= limit / 8)
        return false;
    *narrowed = 8 * upper + ((uint8_t)((uint32_t)raised >> 24) >> 5);
    return *narrowed > -limit;
}

static inline bool accelcal_in_range(int32_t value)
{
    return -2 * ACCELCAL_ONE < value && value < 2 * ACCELCAL_ONE;
}

/* u, K u, a and |a|^2 - 1 of a point; says whether all lie in their ranges of 2, 2 and 1. */
static inline bool accelcal_evaluate(struct accelcal_state *at, const int32_t p[ACCELCAL_PARAMETERS],
                                     const int32_t point[3])
{
    uint8_t axis;
    for (axis = 0; axis < 3; axis++) {
        at->shifted[axis] = point[axis] + p[6 + axis];
        if (!accelcal_in_range(at->shifted[axis]))
            return false;
        at->products[axis] = (int64_t)p[axis] * at->shifted[axis];
    }
    at->products[1] += (int64_t)p[3] * at->shifted[0];
    at->products[2] += (int64_t)p[4] * at->shifted[0] + (int64_t)p[5] * at->shifted[1];
    at->square = -((int64_t)ACCELCAL_ONE * ACCELCAL_ONE);
    for (axis = 0; axis < 3; axis++) {
        if (!accelcal_narrow(at->products[axis], 2 * ACCELCAL_ONE, &at->calibrated[axis]))
            return false;
        at->square += (int64_t)at->calibrated[axis] * at->calibrated[axis];
    }
    return accelcal_narrow(at->square, ACCELCAL_ONE, &at->residual);
}

/* Let one row of K u grow by `more` (58 fraction bits): *square grows by what |a|^2 does. */
static inline bool accelcal_move(const struct accelcal_state *at, uint8_t row, int64_t more, int64_t *square)
{
    const int32_t before = at->calibrated[row];
    int32_t after;
    if (!accelcal_narrow(at->products[row] + more, 2 * ACCELCAL_ONE, &after))
        return false;
    *square += (int64_t)(after - before) * (after + before);
    return true;
}

/* *rise grows by what the squared residual does where |a|^2 - 1 is `square`. */
static inline bool accelcal_compare_cost(const struct accelcal_state *at, int64_t square, int64_t *rise)
{
    int32_t after;
    if (!accelcal_narrow(square, ACCELCAL_ONE, &after))
        return false;
    *rise += (int64_t)(after - at->residual) * (after + at->residual);
    return true;
}

/* What h more of each parameter adds to the sum of squared residuals, by a point (58 fraction bits).
 *
 * Of nine evaluations only what differs from that without h is computed: the bits are the same, the
 * multiplications a third.
 *
 * steps_of_k: h times the first six parameters.
 */
static inline bool accelcal_probe(const struct accelcal_state *at, const int64_t steps_of_k[6],
                                  int64_t rises[ACCELCAL_PARAMETERS])
{
    int64_t steps_of_u[3];
    uint8_t index, axis, row;
    for (axis = 0; axis < 3; axis++) {
        int64_t square = at->square;
        if (!accelcal_in_range(at->shifted[axis] + ACCELCAL_STEP))
            return false;
        for (row = axis; row < 3; row++)
            if (!accelcal_move(at, row, steps_of_k[row == axis ? row : row + axis + 2], &square))
                return false;
        if (!accelcal_compare_cost(at, square, &rises[6 + axis]))
            return false;
        steps_of_u[axis] = (int64_t)at->shifted[axis] * ACCELCAL_STEP;
    }
    for (index = 0; index < 6; index++) {
        int64_t square = at->square;
        if (!accelcal_move(at, accelcal_row[index], steps_of_u[accelcal_column[index]], &square)
            || !accelcal_compare_cost(at, square, &rises[index]))
            return false;
    }
    return true;
}

/* A step of the descent: rate * rise / (points * h), rounded half up; rates have 24 fraction bits.
 *
 * |rise| is below 2**50, since h changes no squared residual by 2e-4 where |a|^2, |u| and |k| are below 2: so
 * nothing overflows here.
 */
static inline int64_t accelcal_step(int64_t rise, int32_t rate)
{
    const int32_t divisor = (int32_t)ACCELCAL_POINTS * ACCELCAL_STEP;
    const int64_t one = (int64_t)divisor << 24;
    int64_t quotient = rise / divisor, rest = rise - quotient * divisor, product, part;
    if (rest < 0) {
        rest += divisor;
        quotient--;
    }
    product = quotient * rate;
    part = (product & 0xFFFFFF) * divisor + rest * rate; /* of one, less than 2 */
    return (product >> 24) + (2 * part >= one) + (2 * part >= 3 * one);
}

/* Find the parameters: 50 iterations from the ideal sensor, rates 0.3, 0.8, 0.2 (F eq. 13-16).
 *
 * points: a full set, as accelcal_points gives it; they are read only.
 * p: where the parameters go.
 *
 * Returns false, and p is worthless, if the points do not determine them: if some |k|, |o|, |u| or |a| on the
 * way is 2 or more, or ||a|^2 - 1| is 1 or more, or a scale ends below 0.25.
 */
static inline bool accelcal_fit(int32_t points[ACCELCAL_POINTS][3], int32_t p[ACCELCAL_PARAMETERS])
{
    static const int32_t rates[3] = {5033165, 13421773, 3355443}; /* scale, misalignment, offset */
    uint8_t iteration, index;
    for (index = 0; index < ACCELCAL_PARAMETERS; index++)
        p[index] = index < 3 ? ACCELCAL_ONE : 0;
    for (iteration = 0; iteration < ACCELCAL_ITERATIONS; iteration++) {
        int64_t rises[ACCELCAL_PARAMETERS], steps_of_k[6];
        for (index = 0; index < ACCELCAL_PARAMETERS; index++) {
            rises[index] = 0;
            if (index < 6)
                steps_of_k[index] = (int64_t)p[index] * ACCELCAL_STEP;
        }
        for (index = 0; index < ACCELCAL_POINTS; index++) {
            struct accelcal_state at;
            if (!accelcal_evaluate(&at, p, points[index]) || !accelcal_probe(&at, steps_of_k, rises))
                return false;
        }
        for (index = 0; index < ACCELCAL_PARAMETERS; index++) {
            const int64_t moved = p[index] - accelcal_step(rises[index], rates[index / 3]);
            if (moved <= -2 * ACCELCAL_ONE || moved >= 2 * ACCELCAL_ONE - ACCELCAL_STEP)
                return false;
            p[index] = (int32_t)moved;
        }
    }
    return p[0] >= ACCELCAL_ONE / 4 && p[1] >= ACCELCAL_ONE / 4 && p[2] >= ACCELCAL_ONE / 4;
}

/* How far |a| is from 1 g in the mean of some points, as ||a|^2 - 1| / 2, in fixed-point g.
 *
 * Of the control points it tells what a fit is worth: F eq. 21 without the root, which is 0.05 mg of 10 mg.
 *
 * Returns ACCELCAL_ONE if there are no points, or one is as far off as that.
 */
static inline int32_t accelcal_error(int32_t points[][3], uint8_t number,
                                     const int32_t p[ACCELCAL_PARAMETERS])
{
    int64_t sum = 0;
    uint8_t index;
    for (index = 0; index < number; index++) {
        struct accelcal_state at;
        if (!accelcal_evaluate(&at, p, points[index]))
            return ACCELCAL_ONE;
        sum += at.residual < 0 ? -at.residual : at.residual;
    }
    return number ? (int32_t)(sum / (2 * number)) : ACCELCAL_ONE;
}

#endif
