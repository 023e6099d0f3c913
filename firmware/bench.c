/* Feeds made windows to accelcal.h and fits them, on an ATmega328P or a Cortex-M3; measure.py runs it.
 *
 * An ATmega328P counts its cycles with timer 1 and tells them by its serial port, in a simulator or on a
 * board. A Cortex-M3 tells by semihosting what it found; its instructions are counted from outside, from each
 * call of `begin` to the next of `end`.
 */
#include "accelcal.h"
#include "case.h" /* CASE_LENGTH, CASE_COUNTS_PER_G, CASE_WINDOWS; case_mean, their raw counts */

enum section { SAMPLE, WINDOW, POINTS, FIT, SECTIONS };

static struct accelcal held;
static int32_t points[ACCELCAL_POINTS][3], parameters[ACCELCAL_PARAMETERS];
static uint32_t most[SECTIONS];

#ifdef __AVR__

#include <avr/io.h>
#include <avr/sleep.h>

extern uint8_t __heap_start;
static uint8_t *const stack_limit = &__heap_start, *const stack_base = (uint8_t *)(RAMEND + 1);

static void set_up(void)
{
    UCSR0B = _BV(TXEN0);
    UBRR0 = 25; /* 38 400 baud at 16 MHz */
}

static void put(char letter)
{
    while (!(UCSR0A & _BV(UDRE0)))
        ;
    UDR0 = (uint8_t)letter;
}

static void begin(enum section section)
{
    TCNT1 = 0;
    TCCR1B = section == FIT ? _BV(CS12) | _BV(CS10) : section == SAMPLE ? _BV(CS10) : _BV(CS11);
}

static void end(enum section section)
{
    const uint32_t counted = TCNT1; /* in units of 1024 cycles, 1 and 8 */
    const uint32_t cycles = section == FIT ? counted << 10 : section == SAMPLE ? counted : counted << 3;
    TCCR1B = 0;
    if (cycles > most[section])
        most[section] = cycles;
}

static void finish(void)
{
    sleep_mode(); /* interrupts are off: a simulator ends here */
}

#else

enum { SEMIHOSTING_WRITE = 3, SEMIHOSTING_EXIT = 0x18, STOPPED_BY_EXIT = 0x20026 };

extern uint8_t end_of_data __asm("_end");
static uint8_t *const stack_limit = &end_of_data, *const stack_base = (uint8_t *)0x20010000;
int main(void);
__attribute__((section(".vectors"), used)) static const uintptr_t vectors[] = {0x20010000, (uintptr_t)main};

static void semihosting(uintptr_t what, uintptr_t with)
{
    register uintptr_t r0 __asm("r0") = what;
    register uintptr_t r1 __asm("r1") = with;
    __asm volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
}

static void set_up(void) {}
static void put(char letter) { semihosting(SEMIHOSTING_WRITE, (uintptr_t)&letter); }
__attribute__((noinline, noclone)) void begin(enum section section) { __asm volatile("" : : "r"(section)); }
__attribute__((noinline, noclone)) void end(enum section section) { __asm volatile("nop" : : "r"(section)); }
static void finish(void) { semihosting(SEMIHOSTING_EXIT, STOPPED_BY_EXIT); }

#endif

enum { PAINT = 0xA5, KEPT_CLEAR = 64 };

static void paint_stack(void)
{
    volatile uint8_t here = 0, *place;
    for (place = stack_limit; (uintptr_t)place < (uintptr_t)&here - KEPT_CLEAR; place++)
        *place = PAINT;
}

static int32_t stack_bytes(void)
{
    const volatile uint8_t *place = stack_limit;
    while (*place == PAINT)
        place++;
    return (int32_t)(stack_base - place);
}

static void tell(const char *name, int32_t value)
{
    char digits[10];
    uint8_t number = 0;
    uint32_t rest = value < 0 ? -(uint32_t)value : (uint32_t)value;
    while (*name)
        put(*name++);
    put(value < 0 ? '-' : ' ');
    do
        digits[number++] = (char)('0' + rest % 10);
    while (rest /= 10);
    while (number)
        put(digits[--number]);
    put('\n');
}

static void feed(void)
{
    uint8_t window;
    uint16_t row;
    for (window = 0; window < CASE_WINDOWS; window++)
        for (row = 1; row <= CASE_LENGTH; row++) {
            const accelcal_count sample[3] = {case_mean(window, 0), case_mean(window, 1), case_mean(window, 2)};
            const enum section section = row < CASE_LENGTH ? SAMPLE : WINDOW;
            begin(section);
            accelcal_add(&held, sample);
            end(section);
        }
}

int main(void)
{
    uint8_t index, number;
    bool found;
    paint_stack();
    set_up();
    accelcal_init(&held, CASE_LENGTH, CASE_COUNTS_PER_G, 0);
    feed();
    begin(POINTS);
    number = accelcal_points(&held, ACCELCAL_FIT, points);
    end(POINTS);
    begin(FIT);
    found = accelcal_fit(points, parameters);
    end(FIT);
    tell("stack", stack_bytes());
    tell("held", sizeof held);
    tell("points", number);
    tell("found", found);
    for (index = 0; index < ACCELCAL_PARAMETERS; index++)
        tell("parameter", parameters[index]);
    for (index = 0; index < SECTIONS; index++)
        tell("cycles", (int32_t)most[index]);
    finish();
    return 0;
}
