/* Fails the Nth call of one kind of operation of libc on files below a folder; preloaded by tests/faults/shim.py.
Or kills all processes of the command before the Nth call of any kind. Writes down which files are opened.

What is to fail stands in a file that all processes of a command map, and the calls are counted there. A call
that is to be short takes half of what it is given. As on Linux, a close that fails has closed the file. */

#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { OPEN, CREATE, READ, WRITE, FSYNC, CLOSE, RENAME, UNLINK, MKDIR, LINK, TRUNCATE, LIST, STAT, FORK, THREAD, ALL };
enum { ONCE = 0, FROM_THEN_ON = 1, KILLS = 2 };
enum { SHORT = -1 };

struct plan {
    int32_t armed, operation, mode, error;
    int64_t nth, fired, count[ALL];
    char under[PATH_MAX];
    char struck[PATH_MAX];
};

static struct plan *plan;
static int opened = -1;

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

__attribute__((constructor)) static void begin(void)
{
    const char *name = getenv("ACCELCAL_FAULTS");
    int file = name ? NEXT(open)(name, O_RDWR) : -1;
    if (file < 0)
        return;
    void *place = mmap(NULL, sizeof(struct plan), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    NEXT(close)(file);
    plan = place == MAP_FAILED ? NULL : place;
    name = getenv("ACCELCAL_OPENED");
    opened = name ? NEXT(open)(name, O_WRONLY | O_APPEND) : -1;
}

/* The place of a name that may be relative to a folder. */
static void whole(char *text, int folder, const char *name)
{
    char link[64], start[PATH_MAX] = "";
    if (name == NULL || name[0] != '/') {
        if (folder == AT_FDCWD)
            snprintf(link, sizeof link, "/proc/self/cwd");
        else
            snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
        ssize_t size = readlink(link, start, sizeof start - 1);
        start[size < 0 ? 0 : size] = 0;
    }
    if (name == NULL || start[0])
        snprintf(text, PATH_MAX, "%.2000s%s%.2000s", start, name ? "/" : "", name ? name : "");
    else
        snprintf(text, PATH_MAX, "%s", name);
}

/* 0, or the error with which this call is to fail. */
static int struck_at(int operation, int folder, const char *name)
{
    if (plan == NULL || !plan->armed)
        return 0;
    int before = errno;
    char text[PATH_MAX] = "";
    if (operation < FORK) {
        whole(text, folder, name);
        if (operation <= CREATE && opened >= 0) {
            struct iovec line[] = { { text, strlen(text) }, { "\n", 1 } };
            if (NEXT(writev)(opened, line, 2) < 0)
                abort();
        }
        errno = before;
        if (strncmp(text, plan->under, strlen(plan->under)))
            return 0;
    }
    if (plan->mode == KILLS) {
        if (__sync_add_and_fetch(&plan->fired, 1) == plan->nth)
            kill(0, SIGKILL);
        return 0;
    }
    int64_t number = __sync_add_and_fetch(&plan->count[operation], 1);
    if (plan->operation != operation || plan->nth == 0 || number < plan->nth || (plan->mode == ONCE && number > plan->nth))
        return 0;
    if (__sync_fetch_and_add(&plan->fired, 1) == 0)
        snprintf(plan->struck, PATH_MAX, "%s", text);
    return plan->error;
}

static int struck(int operation, int file) { return struck_at(operation, file, NULL); }

#define FAIL(value, error) do { errno = (error); return (value); } while (0)
#define FAILS(value, operation, folder, name) \
    do { int _error = struck_at(operation, folder, name); if (_error) FAIL(value, _error); } while (0)

static int opening(int flags) { return flags & (O_CREAT | O_WRONLY | O_RDWR) ? CREATE : OPEN; }

#define OPENER(name) \
    int name(const char *path, int flags, ...) \
    { \
        va_list more; va_start(more, flags); mode_t mode = va_arg(more, mode_t); va_end(more); \
        FAILS(-1, opening(flags), AT_FDCWD, path); \
        return NEXT(name)(path, flags, mode); \
    }
#define OPENER_AT(name) \
    int name(int folder, const char *path, int flags, ...) \
    { \
        va_list more; va_start(more, flags); mode_t mode = va_arg(more, mode_t); va_end(more); \
        FAILS(-1, opening(flags), folder, path); \
        return NEXT(name)(folder, path, flags, mode); \
    }
OPENER(open)
OPENER(open64)
OPENER_AT(openat)
OPENER_AT(openat64)

#define MOVES(name, operation, buffer) \
    ssize_t name(int file, buffer data, size_t count) \
    { \
        int error = struck(operation, file); \
        if (error == SHORT) count = (count + 1) / 2; \
        else if (error) FAIL(-1, error); \
        return NEXT(name)(file, data, count); \
    }
#define MOVES_AT(name, operation, buffer) \
    ssize_t name(int file, buffer data, size_t count, off_t at) \
    { \
        int error = struck(operation, file); \
        if (error == SHORT) count = (count + 1) / 2; \
        else if (error) FAIL(-1, error); \
        return NEXT(name)(file, data, count, at); \
    }
MOVES(read, READ, void *)
MOVES(write, WRITE, const void *)
MOVES_AT(pread, READ, void *)
MOVES_AT(pread64, READ, void *)
MOVES_AT(pwrite, WRITE, const void *)
MOVES_AT(pwrite64, WRITE, const void *)

#define VECTOR(name, operation) \
    ssize_t name(int file, const struct iovec *parts, int count) \
    { \
        int error = struck(operation, file); \
        if (error == SHORT) count = (count + 1) / 2; \
        else if (error) FAIL(-1, error); \
        return NEXT(name)(file, parts, count); \
    }
VECTOR(readv, READ)
VECTOR(writev, WRITE)

ssize_t sendfile(int to, int from, off_t *at, size_t count)
{
    int error = struck(WRITE, to);
    if (error == SHORT) count = (count + 1) / 2;
    else if (error) FAIL(-1, error);
    return NEXT(sendfile)(to, from, at, count);
}

int fsync(int file) { FAILS(-1, FSYNC, file, NULL); return NEXT(fsync)(file); }
int fdatasync(int file) { FAILS(-1, FSYNC, file, NULL); return NEXT(fdatasync)(file); }

int close(int file)
{
    int error = struck(CLOSE, file);
    int done = NEXT(close)(file);
    if (error) FAIL(-1, error);
    return done;
}

int rename(const char *from, const char *to) { FAILS(-1, RENAME, AT_FDCWD, to); return NEXT(rename)(from, to); }

int renameat(int from, const char *old, int to, const char *name)
{
    FAILS(-1, RENAME, to, name);
    return NEXT(renameat)(from, old, to, name);
}

int unlink(const char *path) { FAILS(-1, UNLINK, AT_FDCWD, path); return NEXT(unlink)(path); }

int unlinkat(int folder, const char *path, int flags)
{
    FAILS(-1, UNLINK, folder, path);
    return NEXT(unlinkat)(folder, path, flags);
}

int rmdir(const char *path) { FAILS(-1, UNLINK, AT_FDCWD, path); return NEXT(rmdir)(path); }
int mkdir(const char *path, mode_t mode) { FAILS(-1, MKDIR, AT_FDCWD, path); return NEXT(mkdir)(path, mode); }

int mkdirat(int folder, const char *path, mode_t mode)
{
    FAILS(-1, MKDIR, folder, path);
    return NEXT(mkdirat)(folder, path, mode);
}

int link(const char *from, const char *to) { FAILS(-1, LINK, AT_FDCWD, to); return NEXT(link)(from, to); }

int linkat(int from, const char *old, int to, const char *name, int flags)
{
    FAILS(-1, LINK, to, name);
    return NEXT(linkat)(from, old, to, name, flags);
}

int ftruncate(int file, off_t size) { FAILS(-1, TRUNCATE, file, NULL); return NEXT(ftruncate)(file, size); }
int ftruncate64(int file, off64_t size) { FAILS(-1, TRUNCATE, file, NULL); return NEXT(ftruncate64)(file, size); }

#define ASKS(name, kind) \
    int name(const char *path, struct kind *found) { FAILS(-1, STAT, AT_FDCWD, path); return NEXT(name)(path, found); }
#define ASKS_OPEN(name, kind) \
    int name(int file, struct kind *found) { FAILS(-1, STAT, file, NULL); return NEXT(name)(file, found); }
#define ASKS_AT(name, kind) \
    int name(int folder, const char *path, struct kind *found, int flags) \
    { \
        FAILS(-1, STAT, folder, path); \
        return NEXT(name)(folder, path, found, flags); \
    }
ASKS(stat, stat)
ASKS(lstat, stat)
ASKS(stat64, stat64)
ASKS(lstat64, stat64)
ASKS_OPEN(fstat, stat)
ASKS_OPEN(fstat64, stat64)
ASKS_AT(fstatat, stat)
ASKS_AT(fstatat64, stat64)

DIR *opendir(const char *path) { FAILS(NULL, LIST, AT_FDCWD, path); return NEXT(opendir)(path); }
DIR *fdopendir(int file) { FAILS(NULL, LIST, file, NULL); return NEXT(fdopendir)(file); }

pid_t fork(void) { FAILS(-1, FORK, AT_FDCWD, NULL); return NEXT(fork)(); }

/* A wrapper cannot return twice from a vfork; where one is right, so is a fork. */
pid_t vfork(void) { return fork(); }

int pthread_create(pthread_t *thread, const pthread_attr_t *how, void *(*work)(void *), void *with)
{
    int error = struck(THREAD, AT_FDCWD);
    return error ? error : NEXT(pthread_create)(thread, how, work, with);
}
