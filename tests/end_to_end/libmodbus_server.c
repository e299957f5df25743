/* A Modbus/TCP server of libmodbus on a free port of 127.0.0.1, which it prints; or, with a serial port
 * as its argument, an RTU slave with unit 1 at 19200-8N1.
 *
 * It answers one connection after another until it is killed. After each request its input registers
 * count up and its discrete inputs rotate, so that a poll seldom brings what the one before brought.
 */

#include <modbus.h>
#include <netinet/in.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { SIZE = 200 };

static void change(modbus_mapping_t *tables)
{
    uint8_t first = tables->tab_input_bits[0];
    memmove(tables->tab_input_bits, tables->tab_input_bits + 1, SIZE - 1);
    tables->tab_input_bits[SIZE - 1] = first;
    for (int i = 0; i < SIZE; i++)
        tables->tab_input_registers[i] += i + 1;
}

static int listen_anywhere(void)
{
    struct sockaddr_in address = {
        .sin_family = AF_INET,
        .sin_addr.s_addr = htonl(INADDR_LOOPBACK),
    };
    socklen_t length = sizeof address;
    int listener = socket(AF_INET, SOCK_STREAM, 0);
    if (bind(listener, (struct sockaddr *)&address, length) || listen(listener, 1)
        || getsockname(listener, (struct sockaddr *)&address, &length))
        return -1;
    printf("listening on tcp:127.0.0.1:%d\n", ntohs(address.sin_port));
    fflush(stdout);
    return listener;
}

static void serve(modbus_t *server, modbus_mapping_t *tables)
{
    uint8_t request[MODBUS_TCP_MAX_ADU_LENGTH];
    int length;
    while ((length = modbus_receive(server, request)) >= 0) {
        if (length > 0 && modbus_reply(server, request, length, tables) < 0)
            break;
        change(tables);
    }
}

int main(int count, char **arguments)
{
    int is_serial = count > 1;
    modbus_t *server = is_serial ? modbus_new_rtu(arguments[1], 19200, 'N', 8, 1)
                                 : modbus_new_tcp("127.0.0.1", 0);
    modbus_mapping_t *tables = modbus_mapping_new(SIZE, SIZE, SIZE, SIZE);
    int listener = is_serial ? 0 : listen_anywhere();
    if (server == NULL || tables == NULL || listener < 0)
        return 1;
    for (int i = 0; i < SIZE; i++) {
        tables->tab_input_bits[i] = i % 3 == 0;
        tables->tab_input_registers[i] = tables->tab_registers[i] = 100 * i;
    }
    if (is_serial) {
        if (modbus_set_slave(server, 1) || modbus_connect(server))
            return 1;
        printf("listening on port 0\n");
        fflush(stdout);
        for (;;)
            serve(server, tables);
    }
    for (;;) {
        if (modbus_tcp_accept(server, &listener) < 0)
            return 1;
        serve(server, tables);
        modbus_close(server);
    }
}
