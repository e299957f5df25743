/* Journal of all that a program does to the files of one folder, for LD_PRELOAD.
 *
 * POWER_CUTS_FOLDER is the folder (an absolute path without links), POWER_CUTS_JOURNAL the file
 * that the records are appended to. A record is its length (uint32, of all behind it), the kind (a
 * letter), the time in ns of a clock that never steps and two numbers (int64), a path with its length
 * (uint32), a second one, and bytes:
 *
 *     O  a file was created: inode, 0, path          T  a file was cut or extended: inode, length
 *     W  bytes were written: inode, offset, bytes    R  a rename: 0, 0, old path, new path
 *     U  a file was removed: 0, 0, path              D  a folder was created: 0, 0, path
 *     B  a sync begins: inode, number, path          E  the sync with this number has ended
 *     S  the program told somebody: it sent bytes to a socket, or wrote to standard output
 *
 * All but B are written when the call has returned. A write that another thread does meanwhile may
 * so be noted behind the sync that it came before; it then counts as not synced. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static int journal = -1;
static const char *folder;
static atomic_long syncs; /* How many have begun; each has a number that no other process has. */

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("POWER_CUTS_JOURNAL");
    folder = getenv("POWER_CUTS_FOLDER");
    if (path == NULL || folder == NULL)
        return;
    int low = syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    journal = fcntl(low, F_DUPFD_CLOEXEC, 500); /* Programs close low descriptors. */
    syscall(SYS_close, low);
}

static void note(char kind, int64_t one, int64_t two, const char *path, const char *other,
                 const void *data, size_t size) {
    uint32_t first = path ? strlen(path) : 0, second = other ? strlen(other) : 0;
    size_t length = 1 + 24 + 4 + first + 4 + second + size;
    char *record = malloc(4 + length), *at = record;
    uint32_t whole = length;
    int kept = errno;
    struct timespec clock;
    clock_gettime(CLOCK_MONOTONIC, &clock);
    int64_t now = clock.tv_sec * 1000000000LL + clock.tv_nsec;
#define PUT(from, many) (memcpy(at, from, many), at += (many))
    PUT(&whole, 4); PUT(&kind, 1); PUT(&now, 8); PUT(&one, 8); PUT(&two, 8);
    PUT(&first, 4); if (first) PUT(path, first);
    PUT(&second, 4); if (second) PUT(other, second);
    if (size) PUT(data, size);
    if (syscall(SYS_write, journal, record, at - record) != at - record)
        abort();
    free(record);
    errno = kept;
}

static int is_inside(const char *path) {
    size_t size = strlen(folder);
    return strncmp(path, folder, size) == 0 && (path[size] == '/' || path[size] == 0);
}

/* The inode of an open file inside the folder, and its path; 0 for any other descriptor. */
static int64_t inode_of(int fd, char *path) {
    char link[64];
    struct stat state;
    if (journal < 0 || fd < 0)
        return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t size = syscall(SYS_readlinkat, AT_FDCWD, link, path, PATH_MAX - 1);
    if (size <= 0)
        return 0;
    path[size] = 0;
    return is_inside(path) && fstat(fd, &state) == 0 ? (int64_t)state.st_ino : 0;
}

/* An absolute path inside the folder; 0 for any other. The last part may be absent. */
static int place_of(int at, const char *path, char *found) {
    char whole[PATH_MAX], parent[PATH_MAX], base[64];
    if (journal < 0)
        return 0;
    if (path[0] == '/')
        snprintf(whole, sizeof whole, "%s", path);
    else {
        snprintf(base, sizeof base, at == AT_FDCWD ? "/proc/self/cwd" : "/proc/self/fd/%d", at);
        ssize_t size = syscall(SYS_readlinkat, AT_FDCWD, base, parent, sizeof parent - 1);
        if (size <= 0)
            return 0;
        parent[size] = 0;
        if ((size_t)snprintf(whole, sizeof whole, "%s/%s", parent, path) >= sizeof whole)
            return 0;
    }
    char *name = strrchr(whole, '/');
    *name++ = 0;
    if (realpath(whole[0] ? whole : "/", parent) == NULL)
        return 0;
    if (snprintf(found, PATH_MAX, "%s/%s", parent, name) >= PATH_MAX)
        return 0;
    return is_inside(found);
}

static int opened(int fd, int flags, int was_there) {
    char path[PATH_MAX];
    int64_t inode;
    if (fd >= 0 && (flags & (O_CREAT | O_TRUNC)) && (inode = inode_of(fd, path))) {
        if (!was_there)
            note('O', inode, 0, path, NULL, NULL, 0);
        else if (flags & O_TRUNC)
            note('T', inode, 0, path, NULL, NULL, 0);
    }
    return fd;
}

#define OPENS(name, at, ...)                                                                   \
    {                                                                                          \
        mode_t mode = 0;                                                                       \
        if (flags & (O_CREAT | O_TMPFILE)) {                                                   \
            va_list rest;                                                                      \
            va_start(rest, flags);                                                             \
            mode = va_arg(rest, mode_t);                                                       \
            va_end(rest);                                                                      \
        }                                                                                      \
        int was_there = faccessat(at, path, F_OK, 0) == 0;                                     \
        return opened(NEXT(name)(__VA_ARGS__, mode), flags, was_there);                        \
    }

int open(const char *path, int flags, ...) OPENS(open, AT_FDCWD, path, flags)
int open64(const char *path, int flags, ...) OPENS(open64, AT_FDCWD, path, flags)
int openat(int at, const char *path, int flags, ...) OPENS(openat, at, at, path, flags)
int openat64(int at, const char *path, int flags, ...) OPENS(openat64, at, at, path, flags)

ssize_t write(int fd, const void *data, size_t size) {
    char path[PATH_MAX];
    int64_t inode = inode_of(fd, path);
    int64_t offset = inode ? lseek(fd, 0, SEEK_CUR) : 0;
    ssize_t done = NEXT(write)(fd, data, size);
    if (done > 0 && inode) {
        if (fcntl(fd, F_GETFL) & O_APPEND)
            offset = lseek(fd, 0, SEEK_CUR) - done;
        note('W', inode, offset, path, NULL, data, done);
    } else if (done > 0 && fd == 1 && journal >= 0)
        note('S', 0, 0, NULL, NULL, data, done);
    return done;
}

static ssize_t placed(int fd, const void *data, ssize_t done, off_t offset) {
    char path[PATH_MAX];
    int64_t inode = inode_of(fd, path);
    if (done > 0 && inode)
        note('W', inode, offset, path, NULL, data, done);
    return done;
}

ssize_t pwrite(int fd, const void *data, size_t size, off_t offset) {
    return placed(fd, data, NEXT(pwrite)(fd, data, size, offset), offset);
}

ssize_t pwrite64(int fd, const void *data, size_t size, off64_t offset) {
    return placed(fd, data, NEXT(pwrite64)(fd, data, size, offset), offset);
}

ssize_t send(int fd, const void *data, size_t size, int flags) {
    ssize_t done = NEXT(send)(fd, data, size, flags);
    if (done > 0 && journal >= 0)
        note('S', 0, 0, NULL, NULL, data, done);
    return done;
}

static int resized(int fd, off_t length, int code) {
    char path[PATH_MAX];
    int64_t inode = inode_of(fd, path);
    if (code == 0 && inode)
        note('T', inode, length, path, NULL, NULL, 0);
    return code;
}

int ftruncate(int fd, off_t length) { return resized(fd, length, NEXT(ftruncate)(fd, length)); }
int ftruncate64(int fd, off64_t length) {
    return resized(fd, length, NEXT(ftruncate64)(fd, length));
}

int renameat(int old_at, const char *old, int new_at, const char *new) {
    char from[PATH_MAX], to[PATH_MAX];
    int is_known = place_of(old_at, old, from) & place_of(new_at, new, to);
    int code = NEXT(renameat)(old_at, old, new_at, new);
    if (code == 0 && is_known)
        note('R', 0, 0, from, to, NULL, 0);
    return code;
}

int rename(const char *old, const char *new) { return renameat(AT_FDCWD, old, AT_FDCWD, new); }

int unlinkat(int at, const char *path, int flags) {
    char place[PATH_MAX];
    int is_known = place_of(at, path, place);
    int code = NEXT(unlinkat)(at, path, flags);
    if (code == 0 && is_known)
        note('U', 0, 0, place, NULL, NULL, 0);
    return code;
}

int unlink(const char *path) { return unlinkat(AT_FDCWD, path, 0); }

int mkdir(const char *path, mode_t mode) {
    char place[PATH_MAX];
    int is_known = place_of(AT_FDCWD, path, place);
    int code = NEXT(mkdir)(path, mode);
    if (code == 0 && is_known)
        note('D', 0, 0, place, NULL, NULL, 0);
    return code;
}

#define SYNCS(name)                                                                            \
    {                                                                                          \
        char path[PATH_MAX];                                                                   \
        int64_t inode = inode_of(fd, path), number = inode ? ((int64_t)getpid() << 32) + ++syncs : 0;                      \
        if (inode)                                                                             \
            note('B', inode, number, path, NULL, NULL, 0);                                     \
        int code = NEXT(name)(fd);                                                             \
        if (inode && code == 0)                                                                \
            note('E', inode, number, path, NULL, NULL, 0);                                     \
        return code;                                                                           \
    }

int fsync(int fd) SYNCS(fsync)
int fdatasync(int fd) SYNCS(fdatasync)
