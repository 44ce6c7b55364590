// The corrector for C++11 and newer: owns its memory, throws while loading, never in the loop.
//
// SPDX-License-Identifier: Apache-2.0 OR MIT OR GPL-2.0-or-later
#ifndef KILTER_CORRECTOR_HPP
#define KILTER_CORRECTOR_HPP

#include "kilter_corrector.h"

#include <cstddef>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

namespace kilter {

// A program that cannot be loaded: what() says why and what to do, code() is the reason of kc_load.
class ProgramError : public std::runtime_error {
public:
    explicit ProgramError(int code) : std::runtime_error(kc_sentence(code)), code_(code) {}
    int code() const noexcept { return code_; }

private:
    int code_;
};

using Program = std::vector<unsigned char>;

// Reads what `kilter version export VERSION --format corrector -o FILE` wrote.
inline Program read_program(const std::string &file)
{
    std::ifstream in(file, std::ios::binary);
    if (!in) {
        throw std::runtime_error(file + ": cannot be read.");
    }
    return Program(std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>());
}

class Corrector {
public:
    // settled: the arm rests at the first setpoint, which gets the whole correction at once; else it ramps in.
    explicit Corrector(const Program &program, bool settled = false) : state_(), memory_(doubles_of(program))
    {
        check(kc_load(&state_, program.data(), program.size(), memory_.data(), memory_.size(), settled));
    }
    Corrector(const Corrector &) = delete; // the C state points into this object's memory
    Corrector &operator=(const Corrector &) = delete;

    // Goes on with another version of the same arm; the difference is ramped. Allocates: not for the loop.
    void change(const Program &program)
    {
        std::vector<double> next(doubles_of(program));
        check(kc_change(&state_, program.data(), program.size(), next.data(), next.size()));
        memory_.swap(next); // moves no element, so the state still points to them
    }

    void restart(bool settled = false) noexcept { kc_restart(&state_, settled); }

    // Corrects one setpoint of joints() numbers, dt seconds after the last; `corrected` is NaN unless KC_OK.
    int operator()(const double *q, double dt, double *corrected, kc_answer *answer = nullptr) noexcept
    {
        return kc_correct(&state_, q, nullptr, nullptr, dt, corrected, answer);
    }

    // The same with speeds and accelerations: then the loads include motion.
    int operator()(const double *q, const double *qd, const double *qdd, double dt, double *corrected,
                   kc_answer *answer = nullptr) noexcept
    {
        return kc_correct(&state_, q, qd, qdd, dt, corrected, answer);
    }

    std::size_t joints() const noexcept { return static_cast<std::size_t>(state_.joints); }
    std::string version() const { return state_.version; }
    std::string robot() const { return state_.robot; }

private:
    static void check(int code)
    {
        if (code != 0) {
            throw ProgramError(code);
        }
    }

    static std::size_t doubles_of(const Program &program)
    {
        const std::size_t doubles = kc_memory_needed(program.data(), program.size());
        return doubles == 0 ? 1 : doubles; // kc_load then says what is wrong
    }

    kc_corrector state_;
    std::vector<double> memory_;
};

} // namespace kilter
#endif
