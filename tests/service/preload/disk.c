/* While the file TEST_DISK begins with "f", nothing can be written below the folder TEST_FOLDER, as on a full disk (ENOSPC).
 * While it begins with "r", everything there can be read only (EROFS), also through files that are open: as after an error of
 * the disk, when the kernel remounts its file system. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/uio.h>
#include <unistd.h>

static const volatile char *state;
static const char *folder;

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define REFUSED(there, path, failed) if (state && *state == 'r' && there(path)) { errno = EROFS; return failed; }

__attribute__((constructor)) static void begin(void) {
    int file = REAL(open)(getenv("TEST_DISK"), O_RDONLY);
    void *page = mmap(0, 1, PROT_READ, MAP_SHARED, file, 0);
    folder = getenv("TEST_FOLDER");
    if (page != MAP_FAILED) state = page;
    close(file);
}

static int in_folder(const char *path) {
    size_t length = strlen(folder);
    return !strncmp(path, folder, length) && (path[length] == '/' || !path[length]);
}

static int open_in_folder(int file) {
    char name[64], path[4096];
    snprintf(name, sizeof name, "/proc/self/fd/%d", file);
    ssize_t length = readlink(name, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return in_folder(path);
}

static int at_folder(int at, const char *path) {
    return in_folder(path) || (*path != '/' && at != AT_FDCWD && open_in_folder(at));
}

#define CHANGES(flags) ((flags) & (O_WRONLY | O_RDWR | O_CREAT | O_TRUNC))
#define MODE(flags) \
    mode_t mode = 0; \
    va_list rest; \
    va_start(rest, flags); \
    if ((flags) & (O_CREAT | O_TMPFILE)) mode = va_arg(rest, mode_t); \
    va_end(rest);
#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        MODE(flags) \
        if (CHANGES(flags)) REFUSED(in_folder, path, -1) \
        return REAL(name)(path, flags, mode); \
    }
#define OPEN_AT(name) \
    int name(int at, const char *path, int flags, ...) { \
        MODE(flags) \
        if (CHANGES(flags) && state && *state == 'r' && at_folder(at, path)) { errno = EROFS; return -1; } \
        return REAL(name)(at, path, flags, mode); \
    }
OPEN(open)
OPEN(open64)
OPEN_AT(openat)
OPEN_AT(openat64)

#define WRITE(type, name, given, passed) \
    type name given { \
        REFUSED(open_in_folder, file, -1) \
        if (state && *state == 'f' && open_in_folder(file)) { errno = ENOSPC; return -1; } \
        return REAL(name) passed; \
    }
WRITE(ssize_t, write, (int file, const void *data, size_t size), (file, data, size))
WRITE(ssize_t, pwrite, (int file, const void *data, size_t size, off_t at), (file, data, size, at))
WRITE(ssize_t, pwrite64, (int file, const void *data, size_t size, off64_t at), (file, data, size, at))
WRITE(ssize_t, writev, (int file, const struct iovec *parts, int count), (file, parts, count))
WRITE(int, ftruncate, (int file, off_t size), (file, size))
WRITE(int, ftruncate64, (int file, off64_t size), (file, size))

#define CHANGE(name, given, passed) \
    int name given { \
        REFUSED(in_folder, path, -1) \
        return REAL(name) passed; \
    }
CHANGE(mkdir, (const char *path, mode_t mode), (path, mode))
CHANGE(unlink, (const char *path), (path))
CHANGE(rmdir, (const char *path), (path))
CHANGE(chmod, (const char *path, mode_t mode), (path, mode))
CHANGE(rename, (const char *path, const char *to), (path, to))

#define STAT(name, type) \
    int name(const char *path, struct type *found) { \
        int failed = REAL(name)(path, found); \
        if (!failed && state && *state == 'r' && in_folder(path)) found->f_flag |= ST_RDONLY; \
        return failed; \
    }
STAT(statvfs, statvfs)
STAT(statvfs64, statvfs64)
