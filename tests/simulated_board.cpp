// A board in simulation: the Verilated port of a package, its UART pins behind a pseudo terminal, bit by bit.
//
//   simulated CLOCKS_PER_BIT [FLIP]    prints the path of the terminal, then runs until it is killed
//
// FLIP: every so many bytes, in either direction, one bit is turned over: a line with noise.
#include <cstdio>
#include <cstdlib>
#include <fcntl.h>
#include <poll.h>
#include <termios.h>
#include <unistd.h>

#include "Vport.h"
#include "verilated.h"

static const long QUIET = 20000;  // clocks without a byte after which the simulation waits for one: over a step's
static const int WAIT_MS = 1;

int main(int argc, char **argv) {
    if (argc < 2) return 2;
    const int clocks = std::atoi(argv[1]);
    const long flip = argc > 2 ? std::atol(argv[2]) : 0;

    const int master = posix_openpt(O_RDWR | O_NOCTTY);
    if (master < 0 || grantpt(master) || unlockpt(master)) return 1;
    const int slave = open(ptsname(master), O_RDWR | O_NOCTTY);  // stays open, so that the host may come and go
    if (slave < 0) return 1;
    termios raw;
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    std::printf("%s\n", ptsname(master));
    std::fflush(stdout);
    fcntl(master, F_SETFL, O_NONBLOCK);

    VerilatedContext context;
    Vport port(&context);
    unsigned char queue[4096];
    ssize_t queued = 0, next = 0;
    int to_board = -1, to_host = -1;  // clocks since the start bit, -1: the line is idle
    unsigned byte_in = 0, byte_out = 0;
    long quiet = 0, bytes = 0;
    port.rst = 1;
    port.uart_rx = 1;
    for (long clock = 0;; clock++) {
        if (clock == 4) port.rst = 0;
        if (to_board < 0) {
            if (next == queued && clock % clocks == 0) {
                queued = read(master, queue, sizeof queue);
                next = 0;
                if (queued <= 0) queued = 0;
            }
            if (next < queued) {
                byte_in = queue[next++];
                if (flip && ++bytes % flip == 0) byte_in ^= 1u << bytes % 8;
                to_board = 0;
                quiet = 0;
            }
        }
        if (to_board >= 0) {
            const int place = to_board / clocks;
            port.uart_rx = place == 0 ? 0 : place <= 8 ? byte_in >> (place - 1) & 1 : 1;
            if (++to_board == 10 * clocks) to_board = -1;
        }
        port.clk = 0;
        port.eval();
        port.clk = 1;
        port.eval();
        if (to_host < 0 && !port.uart_tx) to_host = 0;
        if (to_host >= 0) {
            quiet = 0;
            const int place = to_host / clocks;
            if (to_host % clocks == clocks / 2) {
                if (place >= 1 && place <= 8) byte_out = byte_out >> 1 | (port.uart_tx ? 0x80 : 0);
                if (place == 9) {
                    unsigned char byte = byte_out;
                    if (flip && ++bytes % flip == 0) byte ^= 1u << bytes % 8;
                    while (write(master, &byte, 1) < 0) usleep(100);
                    to_host = -2;
                }
            }
            to_host++;
        }
        if (++quiet > QUIET) {
            pollfd readable = {master, POLLIN, 0};
            poll(&readable, 1, WAIT_MS);
            if (getppid() == 1) return 0;  // the test that started it is gone
        }
    }
}
