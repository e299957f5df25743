/* libmodbus as a master:  libmodbus_master tcp PORT UNIT | libmodbus_master rtu PATH BAUD UNIT
 *
 * Each line of its input is a request, decimal:  CODE ADDRESS QUANTITY  for functions 1 to 4,
 * CODE ADDRESS VALUE...  for 5, 6, 15 and 16. It says  ok VALUE...  or  exception CODE.
 */

#include <errno.h>
#include <modbus.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX = 2000, TRIES = 8, TRY_S = 10 };

static uint8_t bits[MAX];
static uint16_t words[MAX];

static int say(int count, const uint8_t *bits, const uint16_t *words)
{
    if (count < 0) {
        int code = errno - MODBUS_ENOBASE;
        if (code < 1 || code > 11) {
            fprintf(stderr, "%s\n", modbus_strerror(errno));
            return 1;
        }
        printf("exception %d\n", code);
    } else {
        printf("ok");
        for (int i = 0; (bits || words) && i < count; i++)
            printf(" %d", bits ? bits[i] : words[i]);
        printf("\n");
    }
    fflush(stdout);
    return 0;
}

/* Returns how many values were read or written, or -1. */
static int ask(modbus_t *master, int code, int address, int quantity, int values)
{
    switch (code) {
    case 1: return modbus_read_bits(master, address, quantity, bits);
    case 2: return modbus_read_input_bits(master, address, quantity, bits);
    case 3: return modbus_read_registers(master, address, quantity, words);
    case 4: return modbus_read_input_registers(master, address, quantity, words);
    case 5: return modbus_write_bit(master, address, bits[0]);
    case 6: return modbus_write_register(master, address, words[0]);
    case 15: return modbus_write_bits(master, address, values, bits);
    case 16: return modbus_write_registers(master, address, values, words);
    default: exit(2);
    }
}

int main(int argc, char **argv)
{
    static char line[16 * MAX];
    if (argc < 4)
        return 2;
    int is_tcp = strcmp(argv[1], "tcp") == 0;
    modbus_t *master = is_tcp ? modbus_new_tcp("127.0.0.1", atoi(argv[2]))
                              : modbus_new_rtu(argv[2], atoi(argv[3]), 'N', 8, 1);
    if (master == NULL || modbus_set_slave(master, atoi(argv[is_tcp ? 3 : 4])) < 0)
        return 2;
    modbus_set_response_timeout(master, TRY_S, 0);
    modbus_set_byte_timeout(master, 0, 0); /* The whole response has TRY_S. */
    if (modbus_connect(master) < 0) {
        fprintf(stderr, "%s\n", modbus_strerror(errno));
        return 2;
    }
    while (fgets(line, sizeof line, stdin)) {
        int numbers[MAX + 2], count = 0;
        for (char *word = strtok(line, " \n"); word && count < MAX; word = strtok(NULL, " \n"))
            numbers[count++] = atoi(word);
        if (count < 3)
            return 2;
        int address = numbers[1], quantity = numbers[2];
        for (int i = 2; i < count; i++) {
            bits[i - 2] = (uint8_t)numbers[i];
            words[i - 2] = (uint16_t)numbers[i];
        }
        /* A slave drops a request with a long pause inside, as a busy machine makes them. */
        int told = -1;
        for (int tries = 0; tries < TRIES && told < 0; tries++) {
            told = ask(master, numbers[0], address, quantity, count - 2);
            if (told < 0 && errno != ETIMEDOUT)
                break;
        }
        int code = numbers[0];
        int failed = say(told, code <= 2 ? bits : NULL, code == 3 || code == 4 ? words : NULL);
        if (failed)
            return failed;
    }
    return 0;
}
