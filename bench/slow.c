/* A disk that is far away: each call that would ask its server waits first; preloaded by bench/scale.py.

ACCELCAL_SLOW_UNDER: the folder; ACCELCAL_SLOW_US: microseconds a call; ACCELCAL_SLOW_NS: nanoseconds a byte. Calls by
name count, and reading, writing, flushing and closing of files below the folder. Nothing is cached. */

#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static const char *under;
static long call_ns, byte_ns;

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

__attribute__((constructor)) static void begin(void)
{
    under = getenv("ACCELCAL_SLOW_UNDER");
    call_ns = 1000 * atol(getenv("ACCELCAL_SLOW_US") ? getenv("ACCELCAL_SLOW_US") : "0");
    byte_ns = atol(getenv("ACCELCAL_SLOW_NS") ? getenv("ACCELCAL_SLOW_NS") : "0");
}

static void pass(long ns)
{
    struct timespec time = {ns / 1000000000, ns % 1000000000};
    nanosleep(&time, NULL);
}

static int there(const char *name) { return under && name && !strncmp(name, under, strlen(under)); }

static int open_there(int file)
{
    char link[64], name[PATH_MAX];
    if (!under)
        return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t size = readlink(link, name, sizeof name - 1);
    name[size < 0 ? 0 : size] = 0;
    return there(name);
}

#define NAMED(type, name, words, path, ...) \
    type name words \
    { \
        if (there(path)) pass(call_ns); \
        return NEXT(name)(__VA_ARGS__); \
    }
NAMED(int, stat, (const char *restrict path, struct stat *restrict found), path, path, found)
NAMED(int, lstat, (const char *restrict path, struct stat *restrict found), path, path, found)
NAMED(int, fstatat, (int at, const char *restrict path, struct stat *restrict found, int how), path, at, path, found, how)
NAMED(int, stat64, (const char *restrict path, struct stat64 *restrict found), path, path, found)
NAMED(int, lstat64, (const char *restrict path, struct stat64 *restrict found), path, path, found)
NAMED(int, fstatat64, (int at, const char *restrict path, struct stat64 *restrict found, int how), path, at, path, found, how)
NAMED(int, unlink, (const char *path), path, path)
NAMED(int, mkdir, (const char *path, mode_t mode), path, path, mode)
NAMED(int, rename, (const char *from, const char *to), to, from, to)
NAMED(int, link, (const char *from, const char *to), to, from, to)
NAMED(DIR *, opendir, (const char *path), path, path)
NAMED(int, access, (const char *path, int how), path, path, how)
NAMED(ssize_t, readlink, (const char *restrict path, char *restrict text, size_t size), path, path, text, size)

#define OPENER(name) \
    int name(const char *path, int flags, ...) \
    { \
        va_list more; va_start(more, flags); mode_t mode = va_arg(more, mode_t); va_end(more); \
        if (there(path)) pass(call_ns); \
        return NEXT(name)(path, flags, mode); \
    }
OPENER(open)
OPENER(open64)

#define MOVES(name, buffer) \
    ssize_t name(int file, buffer data, size_t count) \
    { \
        ssize_t done = NEXT(name)(file, data, count); \
        if (open_there(file)) pass(call_ns + (done > 0 ? done : 0) * byte_ns); \
        return done; \
    }
#define MOVES_AT(name, buffer) \
    ssize_t name(int file, buffer data, size_t count, off_t at) \
    { \
        ssize_t done = NEXT(name)(file, data, count, at); \
        if (open_there(file)) pass(call_ns + (done > 0 ? done : 0) * byte_ns); \
        return done; \
    }
MOVES(read, void *)
MOVES(write, const void *)
MOVES_AT(pread, void *)
MOVES_AT(pread64, void *)

int fsync(int file) { if (open_there(file)) pass(call_ns); return NEXT(fsync)(file); }
int close(int file) { if (open_there(file)) pass(call_ns); return NEXT(close)(file); }
