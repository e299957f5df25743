/* libmodbus as the slave to compare with: one thread, select, as in its own examples. Prints its
 * port. Connections: 64. */

#include <errno.h>
#include <modbus.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <unistd.h>

int main(void)
{
    modbus_t *context = modbus_new_tcp("127.0.0.1", 0);
    modbus_mapping_t *mapping = modbus_mapping_new(4096, 4096, 4096, 4096);
    struct sockaddr_in address;
    socklen_t size = sizeof address;
    int listening = context == NULL ? -1 : modbus_tcp_listen(context, 64);
    if (listening < 0 || mapping == NULL ||
        getsockname(listening, (struct sockaddr *)&address, &size) < 0) {
        fprintf(stderr, "cannot listen: %s\n", modbus_strerror(errno));
        return 1;
    }
    printf("%d\n", ntohs(address.sin_port));
    fflush(stdout);

    fd_set all;
    int highest = listening;
    FD_ZERO(&all);
    FD_SET(listening, &all);
    for (;;) {
        fd_set ready = all;
        if (select(highest + 1, &ready, NULL, NULL, NULL) < 0)
            return 1;
        for (int fd = 0; fd <= highest; fd++) {
            if (!FD_ISSET(fd, &ready))
                continue;
            if (fd == listening) {
                int accepted = accept(listening, NULL, NULL);
                if (accepted < 0 || accepted >= FD_SETSIZE)
                    continue;
                FD_SET(accepted, &all);
                if (accepted > highest)
                    highest = accepted;
                continue;
            }
            uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
            modbus_set_socket(context, fd);
            int length = modbus_receive(context, query);
            if (length > 0) {
                modbus_reply(context, query, length, mapping);
            } else if (length < 0) {
                close(fd);
                FD_CLR(fd, &all);
            }
        }
    }
}
