// A control loop with the corrector inside: reads wanted joints, one setpoint a line, and writes corrected ones.
//
//     loop PROGRAM CYCLE_S < wanted.txt > corrected.txt
//
// Your controller has its own source of setpoints and its own way to the drives; what stands between is one call. The
// hold and the fade at its end are what a real loop needs besides: a refused setpoint must not leave the arm without one.
//
// SPDX-License-Identifier: Apache-2.0 OR MIT OR GPL-2.0-or-later
#include "kilter_corrector.hpp"

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <sstream>

namespace {

// After a refusal the last correction is held, and after HOLD_S faded out over FADE_S: no step, and no arm left waiting.
const double HOLD_S = 0.1, FADE_S = 1.0;

double share_of_last(double since_s)
{
    if (since_s <= HOLD_S) {
        return 1.0;
    }
    const double part = (since_s - HOLD_S) / FADE_S;
    return part >= 1.0 ? 0.0 : 1.0 - part * part * (3.0 - 2.0 * part);
}

} // namespace

int main(int count, char **arguments)
{
    if (count != 3) {
        std::cerr << "usage: loop PROGRAM CYCLE_S\n";
        return 2;
    }
    try {
        kilter::Corrector correct(kilter::read_program(arguments[1]));
        const double cycle_s = std::atof(arguments[2]);
        if (!(cycle_s > 0.0)) {
            std::cerr << "CYCLE_S is the controller's cycle in seconds, as 0.004\n";
            return 2;
        }
        const std::size_t n = correct.joints();
        std::cerr << correct.robot() << ", version " << correct.version() << ", " << n << " joints\n";
        std::vector<double> wanted(n), corrected(n), last(n, 0.0);
        double since_s = 0.0, dt = cycle_s; // time since the last answer that was OK
        bool stranded = false;
        std::string line;
        for (long cycle = 1; std::getline(std::cin, line); cycle++) {
            std::istringstream numbers(line);
            for (double &q : wanted) {
                numbers >> q;
            }
            if (numbers.fail() || !(numbers >> std::ws).eof()) {
                std::cerr << "setpoint " << cycle << ": give " << n << " numbers, rad or m\n";
                return 2;
            }
            kc_answer answer;
            const int status = correct(wanted.data(), dt, corrected.data(), &answer);
            if (status == KC_OK) {
                since_s = 0.0;
                dt = cycle_s;
                for (std::size_t i = 0; i < n; i++) {
                    last[i] = corrected[i] - wanted[i];
                }
            } else {
                since_s += cycle_s;
                dt += cycle_s;
                for (std::size_t i = 0; i < n; i++) {
                    corrected[i] = wanted[i] + share_of_last(since_s) * last[i];
                }
                stranded = true;
                std::cerr << "setpoint " << cycle << ": " << kc_sentence(status) << "\n";
            }
            for (std::size_t i = 0; i < n; i++) {
                std::printf("%.17g%c", corrected[i], i + 1 < n ? ' ' : '\n');
            }
        }
        return stranded ? 1 : 0;
    } catch (const std::exception &error) {
        std::cerr << error.what() << "\n";
        return 2;
    }
}
