// Drives the emitted core as fast as one thread can: always a sample on offer, always ready for the result.
// Usage: bench samples outputs steps, the samples repeated until `steps` are done; prints CPU seconds and clocks.

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <vector>

#include "Vtop.h"
#include "verilated.h"

static const size_t IN = SAMPLE_BYTES, OUT = RESULT_BYTES;

int main(int argc, char** argv) {
    if (argc != 4) return 2;
    std::vector<unsigned char> samples;
    FILE* file = fopen(argv[1], "rb");
    for (unsigned char block[4096]; size_t n = fread(block, 1, sizeof block, file);) samples.insert(samples.end(), block, block + n);
    fclose(file);
    const size_t rows = samples.size() / IN, steps = strtoull(argv[3], nullptr, 10);
    std::vector<unsigned char> outputs(rows * OUT);

    VerilatedContext context;
    Vtop top{&context};
    auto clock = [&] {
        top.clk = 0;
        top.eval();
        top.clk = 1;
        top.eval();
    };
    top.rst = 1;
    clock();
    top.rst = 0;
    top.m_axis_tready = 1;
    top.s_axis_tvalid = 1;
    memcpy(&top.s_axis_tdata, samples.data(), IN);
    top.eval();

    size_t done = 0, clocks = 0, row = 0, offered = 0;
    const clock_t start = std::clock();
    while (done < steps) {
        const bool taken = top.s_axis_tready;
        clock();
        ++clocks;
        if (taken) {
            if (++offered == rows) offered = 0;
            memcpy(&top.s_axis_tdata, &samples[offered * IN], IN);
        }
        if (top.m_axis_tvalid) {
            memcpy(&outputs[row * OUT], &top.m_axis_tdata, OUT);
            ++done;
            if (++row == rows) row = 0;
        }
    }
    const double seconds = double(std::clock() - start) / CLOCKS_PER_SEC;
    file = fopen(argv[2], "wb");
    fwrite(outputs.data(), 1, outputs.size(), file);
    fclose(file);
    printf("%.6f %zu\n", seconds, clocks);
}
