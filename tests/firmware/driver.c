/* Puts firmware/accelcal.h to the test: binary records on stdin, what it makes of them as lines on stdout.
 *
 * driver LENGTH COUNTS_PER_G FULL_SCALE reads records of four int32: kind, x, y, z; kinds are 0 a sample, 1
 * one that was not measured, 2 a break. `window FATE FIRST` is a window, `fit` and `control` are points.
 * driver fit reads sets of 18 points, and prints the parameters of each, or `diverged`.
 */
#include "accelcal.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SAMPLE, UNMEASURED, BREAK };

static void print_parameters(int32_t points[ACCELCAL_POINTS][3])
{
    int32_t p[ACCELCAL_PARAMETERS];
    int index;
    if (!accelcal_fit(points, p)) {
        puts("diverged");
        return;
    }
    printf("parameters");
    for (index = 0; index < ACCELCAL_PARAMETERS; index++)
        printf(" %ld", (long)p[index]);
    printf("\nerror %ld\n", (long)accelcal_error(points, ACCELCAL_POINTS, p));
}

static int fit_sets(void)
{
    int32_t points[ACCELCAL_POINTS][3];
    while (fread(points, sizeof points, 1, stdin) == 1)
        print_parameters(points);
    return 0;
}

static void print_points(const struct accelcal *held, enum accelcal_set set, const char *name)
{
    int32_t points[ACCELCAL_POINTS][3];
    uint8_t number = accelcal_points(held, set, points), index;
    for (index = 0; index < number; index++)
        printf("%s %ld %ld %ld\n", name, (long)points[index][0], (long)points[index][1],
               (long)points[index][2]);
    if (set == ACCELCAL_FIT && number == ACCELCAL_POINTS)
        print_parameters(points);
}

int main(int number, char **words)
{
    static struct accelcal held;
    int32_t record[4];
    long row = 0;
    if (number == 2 && strcmp(words[1], "fit") == 0)
        return fit_sets();
    if (number != 4)
        return 2;
    if (!accelcal_init(&held, (uint16_t)atol(words[1]), (uint32_t)strtoul(words[2], NULL, 10),
                       (accelcal_sum)atoll(words[3]))) {
        puts("impossible");
        return 0;
    }
    while (fread(record, sizeof record, 1, stdin) == 1) {
        const accelcal_count sample[3] = {(accelcal_count)record[1], (accelcal_count)record[2],
                                          (accelcal_count)record[3]};
        enum accelcal_fate fate = ACCELCAL_OPEN;
        if (record[0] == BREAK) {
            accelcal_break(&held);
            continue;
        }
        row++;
        fate = record[0] == UNMEASURED ? accelcal_add_unmeasured(&held) : accelcal_add(&held, sample);
        if (fate != ACCELCAL_OPEN)
            printf("window %d %ld\n", (int)fate, row - held.length);
    }
    print_points(&held, ACCELCAL_FIT, "fit");
    print_points(&held, ACCELCAL_CONTROL, "control");
    return 0;
}
