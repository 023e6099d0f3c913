/* A device that calibrates itself; measure.py takes its size from this program.
 *
 * `sensor` stands for the registers of an accelerometer at 25 Hz with 256 counts per g and a range of 8 g,
 * `calibration` for the place where the result is kept.
 */
#include "accelcal.h"

static volatile accelcal_count sensor[3];
static volatile int32_t calibration[ACCELCAL_PARAMETERS], error_g;

static struct accelcal held;
static int32_t points[ACCELCAL_POINTS][3], parameters[ACCELCAL_PARAMETERS];

static bool both_sets_are_full(void)
{
    return accelcal_points(&held, ACCELCAL_FIT, points) == ACCELCAL_POINTS
           && accelcal_points(&held, ACCELCAL_CONTROL, points) == ACCELCAL_POINTS;
}

static void calibrate(void)
{
    uint8_t index;
    accelcal_points(&held, ACCELCAL_FIT, points);
    if (accelcal_fit(points, parameters)) {
        for (index = 0; index < ACCELCAL_PARAMETERS; index++)
            calibration[index] = parameters[index];
        accelcal_points(&held, ACCELCAL_CONTROL, points);
        error_g = accelcal_error(points, ACCELCAL_POINTS, parameters);
    }
    accelcal_init(&held, held.length, 256, 2048); /* begin again, for the next calibration */
}

int main(void)
{
    accelcal_init(&held, 5 * 25, 256, 2048);
    for (;;) {
        const accelcal_count sample[3] = {sensor[0], sensor[1], sensor[2]};
        const enum accelcal_fate fate = accelcal_add(&held, sample);
        if ((fate == ACCELCAL_TAKEN_TO_FIT || fate == ACCELCAL_TAKEN_TO_CONTROL) && both_sets_are_full())
            calibrate();
    }
}
