/* A disk that fails: the k-th call that opens for writing, writes, syncs, renames or makes something
   below a folder returns "no space left" (k = 0: none does). For LD_PRELOAD; the test sets `folder`
   and `fails_at`, and reads `calls`. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

char folder[4096];
long calls, fails_at, fails_ever_after;

static int is_below(const char *path) {
  return folder[0] && path && !strncmp(path, folder, strlen(folder));
}

static int is_file_below(int fd) {
  char link[64], path[4096];
  if (!folder[0]) return 0;
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  ssize_t length = readlink(link, path, sizeof path - 1);
  if (length < 0) return 0;
  path[length] = 0;
  return is_below(path);
}

/* Whether this call counts, and is the one that fails. */
static int fails(int counts) {
  if (!counts) return 0;
  long k = __atomic_add_fetch(&calls, 1, __ATOMIC_SEQ_CST);
  int failing = fails_at && (k == fails_at || (fails_ever_after && k > fails_at));
  if (failing) errno = ENOSPC;
  return failing;
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define WRITES (O_WRONLY | O_RDWR | O_CREAT)

#define OPEN(name)                                                           \
  int name(const char *path, int flags, ...) {                               \
    va_list rest;                                                            \
    va_start(rest, flags);                                                   \
    int mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, int) : 0;        \
    va_end(rest);                                                            \
    return fails(flags & WRITES && is_below(path)) ? -1 : REAL(name)(path, flags, mode); \
  }
OPEN(open)
OPEN(open64)

#define OPENAT(name)                                                         \
  int name(int at, const char *path, int flags, ...) {                       \
    va_list rest;                                                            \
    va_start(rest, flags);                                                   \
    int mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, int) : 0;        \
    va_end(rest);                                                            \
    return fails(flags & WRITES && is_below(path)) ? -1 : REAL(name)(at, path, flags, mode); \
  }
OPENAT(openat)
OPENAT(openat64)

#define FOPEN(name)                                                          \
  FILE *name(const char *path, const char *mode) {                           \
    return fails(mode[0] != 'r' && is_below(path)) ? NULL : REAL(name)(path, mode); \
  }
FOPEN(fopen)
FOPEN(fopen64)

ssize_t write(int fd, const void *data, size_t size) {
  return fails(is_file_below(fd)) ? -1 : REAL(write)(fd, data, size);
}
ssize_t pwrite(int fd, const void *data, size_t size, off_t at) {
  return fails(is_file_below(fd)) ? -1 : REAL(pwrite)(fd, data, size, at);
}
int fsync(int fd) { return fails(is_file_below(fd)) ? -1 : REAL(fsync)(fd); }
int ftruncate(int fd, off_t size) {
  return fails(is_file_below(fd)) ? -1 : REAL(ftruncate)(fd, size);
}
int rename(const char *from, const char *to) {
  return fails(is_below(to)) ? -1 : REAL(rename)(from, to);
}
int renameat(int from_at, const char *from, int to_at, const char *to) {
  return fails(is_below(to)) ? -1 : REAL(renameat)(from_at, from, to_at, to);
}
int mkdir(const char *path, mode_t mode) {
  return fails(is_below(path)) ? -1 : REAL(mkdir)(path, mode);
}
