// The throttle and its dead-man: without a fresh command before the deadline the device idles by itself.
// Same rules as bench/rig/throttle_keeper.py.
#pragma once

#include <cstdint>

namespace saranga {

class DeadMan {
 public:
  // A command that came at `now_us`. Out of range or NaN is idle: it can only have come through a fault.
  void command(float value, uint32_t token, uint16_t deadline_ms, uint32_t now_us) {
    const bool sound = value > 0.0f && value <= 1.0f;
    value_ = sound ? value : 0.0f;
    token_ = token;
    since_us_ = now_us;
    span_us_ = static_cast<uint32_t>(deadline_ms) * 1000u;
    armed_ = sound;
  }

  // To be called more often than deadlines are long, from a timer and not from the loop that may hang. True once, when
  // the deadline has just passed. The difference is right across the wrap of a u32 clock at 71.6 minutes.
  bool expire(uint32_t now_us) {
    if (!armed_ || now_us - since_us_ < span_us_) return false;
    idle();
    return true;
  }

  void idle() {
    value_ = 0.0f;
    token_ = 0;
    armed_ = false;
  }

  float value() const { return value_; }
  uint32_t token() const { return token_; }

 private:
  float value_ = 0.0f;
  uint32_t token_ = 0;
  uint32_t since_us_ = 0;
  uint32_t span_us_ = 0;
  bool armed_ = false;
};

// Pulse of an ESC for a throttle: low_us at 0 (and for anything that is no throttle), high_us at 1.
inline float esc_pulse_us(float throttle, float low_us, float high_us) {
  return throttle > 0.0f && throttle <= 1.0f ? low_us + throttle * (high_us - low_us) : low_us;
}

}  // namespace saranga
