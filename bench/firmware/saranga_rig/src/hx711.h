// HX711 load cell amplifier: 24 bits, most significant first, two'"'"'s complement, and the conversion to newtons.
#pragma once

#include <cmath>
#include <cstdint>

namespace saranga {

// The 24 bits read, sign-extended.
inline int32_t hx711_counts(uint32_t bits) {
  bits &= 0xFFFFFFu;
  return bits & 0x800000u ? static_cast<int32_t>(bits) - 0x1000000 : static_cast<int32_t>(bits);
}

// The amplifier at its end: what it says is no measurement.
inline bool hx711_saturated(int32_t counts) { return counts >= 0x7FFFFF || counts <= -0x800000; }

// Newtons from counts; NaN where the amplifier is at its end or the calibration is none.
struct LoadCell {
  int32_t zero_counts = 0;
  float counts_per_n = 0;  // negative where the cell is mounted the other way round

  float newtons(int32_t counts) const {
    if (hx711_saturated(counts) || counts_per_n == 0.0f || !std::isfinite(counts_per_n)) return NAN;
    return static_cast<float>(counts - zero_counts) / counts_per_n;
  }
};

}  // namespace saranga
