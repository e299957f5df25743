/* Asks a Modbus/TCP slave as fast as it answers: FC3 of 10 registers from address 0.
 *
 *     slave_client PORT CONNECTIONS SECONDS
 *
 * Each connection has one request on its way. Every answer is checked. Prints, as JSON, how many
 * there were, how long it took, and the 50th and 99th percentile of the answers' times.
 */

#include <arpa/inet.h>
#include <errno.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define MAX_CONNECTIONS 64
#define MAX_TIMES (1 << 24)
#define ANSWER_BYTES 29 /* header 7, function 1, byte count 1, registers 20 */

struct master {
    uint16_t transaction_id;
    uint64_t asked_ns;
    size_t held;
    uint8_t answer[ANSWER_BYTES];
};

static uint64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

static void fail(const char *what)
{
    fprintf(stderr, "%s: %s\n", what, strerror(errno));
    exit(1);
}

static int connect_to(int port)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    int on = 1, fd = socket(AF_INET, SOCK_STREAM, 0);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (fd < 0 || connect(fd, (struct sockaddr *)&address, sizeof address) < 0)
        fail("connect");
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    return fd;
}

static void ask(int fd, struct master *master)
{
    uint16_t id = ++master->transaction_id;
    uint8_t request[] = {id >> 8, id & 0xFF, 0, 0, 0, 6, 1, 3, 0, 0, 0, 10};
    master->held = 0;
    master->asked_ns = now_ns();
    if (send(fd, request, sizeof request, 0) != sizeof request)
        fail("send");
}

static void check(const struct master *master)
{
    uint8_t head[] = {master->transaction_id >> 8, master->transaction_id & 0xFF,
                      0, 0, 0, ANSWER_BYTES - 6, 1, 3, 20};
    if (memcmp(master->answer, head, sizeof head) != 0) {
        fprintf(stderr, "a wrong answer\n");
        exit(1);
    }
}

static int by_size(const void *one, const void *other)
{
    uint32_t a = *(const uint32_t *)one, b = *(const uint32_t *)other;
    return (a > b) - (a < b);
}

int main(int argc, char **argv)
{
    static struct pollfd fds[MAX_CONNECTIONS];
    static struct master masters[MAX_CONNECTIONS];
    uint32_t *times = malloc(MAX_TIMES * sizeof *times);
    size_t count = 0;
    if (argc != 4 || times == NULL)
        return 2;
    int connections = atoi(argv[2]);
    if (connections < 1 || connections > MAX_CONNECTIONS)
        return 2;
    for (int i = 0; i < connections; i++) {
        fds[i].fd = connect_to(atoi(argv[1]));
        fds[i].events = POLLIN;
    }
    uint64_t begun_ns = now_ns(), end_ns = begun_ns + (uint64_t)(atof(argv[3]) * 1e9);
    for (int i = 0; i < connections; i++)
        ask(fds[i].fd, &masters[i]);
    while (now_ns() < end_ns && count < MAX_TIMES - MAX_CONNECTIONS) {
        if (poll(fds, (nfds_t)connections, 5000) <= 0)
            fail("no answer for 5 s");
        for (int i = 0; i < connections; i++) {
            struct master *master = &masters[i];
            if (!(fds[i].revents & (POLLIN | POLLERR | POLLHUP)))
                continue;
            ssize_t got = recv(fds[i].fd, master->answer + master->held,
                               ANSWER_BYTES - master->held, 0);
            if (got <= 0)
                fail("recv");
            master->held += (size_t)got;
            if (master->held == ANSWER_BYTES) {
                check(master);
                times[count++] = (uint32_t)(now_ns() - master->asked_ns);
                ask(fds[i].fd, master);
            }
        }
    }
    double seconds = (double)(now_ns() - begun_ns) / 1e9;
    qsort(times, count, sizeof *times, by_size);
    printf("{\"count\": %zu, \"seconds\": %.6f, \"p50_ns\": %u, \"p99_ns\": %u}\n", count, seconds,
           times[count / 2], times[count * 99 / 100]);
    return 0;
}
