/* A machine that fails as told: stands between a program and its C library (LD_PRELOAD).
 *
 * What happens to the files of one folder, or to those whose names begin so, is refused as the control block says, and written down in a log, so that the
 * state after a power cut at any moment can be made from it. The wall clock is moved by the control block too, which is
 * a file that the test maps as well; `machine.py` has the same order of fields.
 *
 * One lock is held around every call on such a file and its record: the order of the log is the order of the calls.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { FD_LIMIT = 4096, PATH_LIMIT = 512 };

struct control {
    int64_t wall_offset_ns;
    int64_t write_errno;  /* writes, and whatever changes a name or a size */
    int64_t sync_errno;
    int64_t read_errno;
    int64_t open_errno;   /* opening for writing */
    int64_t room_bytes;   /* by which files may still grow; below zero there is no limit */
    int64_t sync_delay_us;
    int64_t recorded_bytes;
    int64_t refused_count;
};

struct record {
    int64_t kind, inode, offset, length;
};

static struct control *control;
static int log_fd = -1;
static char folder[PATH_LIMIT];
static char beginning[PATH_LIMIT];
static char tracked[FD_LIMIT][PATH_LIMIT];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

/* Called by the program itself, once, before it touches any file: a process that others are forked from is loaded with
 * this library long before it is known which disk each of them gets. */
void machine_begin(const char *place, const char *path_beginning, const char *block, const char *log) {
    strncpy(folder, place, PATH_LIMIT - 1);
    strncpy(beginning, path_beginning, PATH_LIMIT - 1);
    int fd = (int)syscall(SYS_openat, AT_FDCWD, block, O_RDWR | O_CLOEXEC, 0);
    void *mapped = mmap(NULL, sizeof(struct control), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (fd < 0 || mapped == MAP_FAILED) _exit(97);
    syscall(SYS_close, fd);
    if (*log) {
        /* A high number: programs close the low ones. */
        int low = (int)syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_APPEND | O_CLOEXEC, 0);
        log_fd = (int)syscall(SYS_fcntl, low, F_DUPFD_CLOEXEC, 500);
        syscall(SYS_close, low);
    }
    control = mapped;
}

static void note(char kind, int64_t inode, int64_t offset, const void *data, size_t length) {
    if (log_fd < 0) return;
    struct record head = {kind, inode, offset, (int64_t)length};
    struct iovec parts[2] = {{&head, sizeof head}, {(void *)data, length}};
    if (syscall(SYS_writev, log_fd, parts, 2) != (long)(sizeof head + length)) _exit(98);
    __atomic_add_fetch(&control->recorded_bytes, sizeof head + length, __ATOMIC_SEQ_CST);
}

static int refuse(int64_t reason) {
    __atomic_add_fetch(&control->refused_count, 1, __ATOMIC_SEQ_CST);
    errno = (int)reason;
    return -1;
}

static int is_tracked(int fd) { return control && fd >= 0 && fd < FD_LIMIT && tracked[fd][0]; }
static int is_inside(const char *path) {
    return control && path && (!strncmp(path, beginning, strlen(beginning)) || !strcmp(path, folder));
}
static int64_t inode_of(int fd) {
    struct stat found;
    return fstat(fd, &found) ? -1 : (int64_t)found.st_ino;
}

static int open_file(int at, const char *path, int flags, mode_t mode) {
    char whole[PATH_LIMIT] = "";
    if (control && path && path[0] != '/' && at == AT_FDCWD && getcwd(whole, sizeof whole) && strlen(whole) + strlen(path) < PATH_LIMIT - 2) {
        strcat(whole, "/");
        strcat(whole, path);
    } else if (path && strlen(path) < PATH_LIMIT)
        strcpy(whole, path);
    if (!is_inside(whole)) {
        int fd = (int)syscall(SYS_openat, at, path, flags, mode);
        if (fd >= 0 && fd < FD_LIMIT) tracked[fd][0] = 0;
        return fd;
    }
    pthread_mutex_lock(&lock);
    struct stat before;
    int fresh = stat(whole, &before) != 0, fd;
    if (control->open_errno && (flags & (O_WRONLY | O_RDWR | O_CREAT | O_TRUNC)))
        fd = refuse(control->open_errno);
    else {
        fd = (int)syscall(SYS_openat, at, path, flags, mode);
        if (fd >= 0 && fd < FD_LIMIT) {
            strcpy(tracked[fd], whole);
            if (fresh || (flags & O_TRUNC)) note('O', inode_of(fd), fresh, whole, strlen(whole));
        }
    }
    pthread_mutex_unlock(&lock);
    return fd;
}

#define OPEN_BODY(at)                                   \
    mode_t mode = 0;                                    \
    if (flags & (O_CREAT | O_TMPFILE)) {                \
        va_list rest;                                   \
        va_start(rest, flags);                          \
        mode = va_arg(rest, mode_t);                    \
        va_end(rest);                                   \
    }                                                   \
    return open_file(at, path, flags, mode);

int open(const char *path, int flags, ...) { OPEN_BODY(AT_FDCWD) }
int open64(const char *path, int flags, ...) { OPEN_BODY(AT_FDCWD) }
int openat(int at, const char *path, int flags, ...) { OPEN_BODY(at) }
int openat64(int at, const char *path, int flags, ...) { OPEN_BODY(at) }

int close(int fd) {
    if (is_tracked(fd)) tracked[fd][0] = 0;
    return (int)syscall(SYS_close, fd);
}

static ssize_t put(int fd, const void *data, size_t length, off_t offset) {
    if (!is_tracked(fd)) return offset < 0 ? syscall(SYS_write, fd, data, length) : syscall(SYS_pwrite64, fd, data, length, offset);
    pthread_mutex_lock(&lock);
    ssize_t done;
    struct stat found;
    fstat(fd, &found);
    int64_t at = offset < 0 ? lseek(fd, 0, SEEK_CUR) : offset, growth = at + (int64_t)length - found.st_size;
    if (control->write_errno)
        done = refuse(control->write_errno);
    else if (growth > 0 && control->room_bytes >= 0 && growth > control->room_bytes)
        done = refuse(ENOSPC);
    else {
        done = offset < 0 ? syscall(SYS_write, fd, data, length) : syscall(SYS_pwrite64, fd, data, length, offset);
        if (done > 0) {
            if (growth > 0 && control->room_bytes >= 0) control->room_bytes -= growth;
            note('W', (int64_t)found.st_ino, at, data, (size_t)done);
        }
    }
    pthread_mutex_unlock(&lock);
    return done;
}
ssize_t write(int fd, const void *data, size_t length) { return put(fd, data, length, -1); }
ssize_t pwrite(int fd, const void *data, size_t length, off_t offset) { return put(fd, data, length, offset); }
ssize_t pwrite64(int fd, const void *data, size_t length, off64_t offset) { return put(fd, data, length, offset); }

static ssize_t take(int fd, void *data, size_t length, off_t offset) {
    if (is_tracked(fd) && control->read_errno) return refuse(control->read_errno);
    return offset < 0 ? syscall(SYS_read, fd, data, length) : syscall(SYS_pread64, fd, data, length, offset);
}
ssize_t read(int fd, void *data, size_t length) { return take(fd, data, length, -1); }
ssize_t pread(int fd, void *data, size_t length, off_t offset) { return take(fd, data, length, offset); }
ssize_t pread64(int fd, void *data, size_t length, off64_t offset) { return take(fd, data, length, offset); }

static int resize(int fd, off_t length) {
    if (!is_tracked(fd)) return (int)syscall(SYS_ftruncate, fd, length);
    pthread_mutex_lock(&lock);
    struct stat found;
    fstat(fd, &found);
    int done = control->write_errno ? refuse(control->write_errno) : (int)syscall(SYS_ftruncate, fd, length);
    if (!done) {
        if (control->room_bytes >= 0 && length < found.st_size) control->room_bytes += found.st_size - length;
        note('T', (int64_t)found.st_ino, length, NULL, 0);
    }
    pthread_mutex_unlock(&lock);
    return done;
}
int ftruncate(int fd, off_t length) { return resize(fd, length); }
int ftruncate64(int fd, off64_t length) { return resize(fd, length); }

static int make_last(int fd, long call) {
    if (!is_tracked(fd)) return (int)syscall(call, fd);
    if (control->sync_delay_us) {
        struct timespec pause = {control->sync_delay_us / 1000000, control->sync_delay_us % 1000000 * 1000};
        nanosleep(&pause, NULL);
    }
    pthread_mutex_lock(&lock);
    struct stat found;
    fstat(fd, &found);
    /* The disk itself is not asked: whether something lasts is worked out from the log. */
    int done = control->sync_errno ? refuse(control->sync_errno) : 0;
    if (S_ISDIR(found.st_mode))
        note('D', (int64_t)found.st_ino, done == 0, tracked[fd], strlen(tracked[fd]));
    else
        note('S', (int64_t)found.st_ino, done == 0, NULL, 0);
    pthread_mutex_unlock(&lock);
    return done;
}
int fsync(int fd) { return make_last(fd, SYS_fsync); }
int fdatasync(int fd) { return make_last(fd, SYS_fdatasync); }

int unlink(const char *path) {
    if (!is_inside(path)) return (int)syscall(SYS_unlinkat, AT_FDCWD, path, 0);
    pthread_mutex_lock(&lock);
    struct stat found = {0};
    stat(path, &found);
    int done = control->write_errno ? refuse(control->write_errno) : (int)syscall(SYS_unlinkat, AT_FDCWD, path, 0);
    if (!done) {
        if (control->room_bytes >= 0) control->room_bytes += found.st_size;
        note('U', (int64_t)found.st_ino, 0, path, strlen(path));
    }
    pthread_mutex_unlock(&lock);
    return done;
}

int rename(const char *old, const char *new) {
    if (!is_inside(old)) return REAL(rename)(old, new);
    pthread_mutex_lock(&lock);
    char both[2 * PATH_LIMIT];
    size_t length = strlen(old);
    memcpy(both, old, length + 1);
    strncpy(both + length + 1, new, PATH_LIMIT);
    int done = control->write_errno ? refuse(control->write_errno) : REAL(rename)(old, new);
    if (!done) note('R', 0, 0, both, length + 1 + strlen(new));
    pthread_mutex_unlock(&lock);
    return done;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    int done = (int)syscall(SYS_clock_gettime, clock, now);
    if (!done && control && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) {
        int64_t moved_ns = (int64_t)now->tv_sec * 1000000000 + now->tv_nsec + control->wall_offset_ns;
        now->tv_sec = moved_ns / 1000000000;
        now->tv_nsec = moved_ns % 1000000000;
    }
    return done;
}
time_t time(time_t *out) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (out) *out = now.tv_sec;
    return now.tv_sec;
}
int gettimeofday(struct timeval *now, void *zone) {
    struct timespec precise;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &precise);
    now->tv_sec = precise.tv_sec;
    now->tv_usec = precise.tv_nsec / 1000;
    return 0;
}
