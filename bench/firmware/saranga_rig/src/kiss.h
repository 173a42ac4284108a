// KISS telemetry of BLHeli32 / AM32 ESCs: 10 bytes at 115200, big-endian: C, cV, cA, mAh, eRPM/100, CRC-8 (0x07).
#pragma once

#include <cstddef>
#include <cstdint>

namespace saranga {

struct EscTelemetry {
  float temperature_c = 0;
  float voltage_v = 0;
  float current_a = 0;
  float consumed_mah = 0;
  float rpm = 0;  // of the shaft: 2 eRPM / poles
};

inline uint8_t crc8(const uint8_t* data, size_t size) {
  uint8_t crc = 0;
  for (size_t i = 0; i < size; ++i) {
    crc ^= data[i];
    for (int bit = 0; bit < 8; ++bit) crc = static_cast<uint8_t>(crc & 0x80 ? crc << 1 ^ 0x07 : crc << 1);
  }
  return crc;
}

// Frames out of a byte stream that may begin anywhere. There is no start mark: out of step it slides on byte by byte, and
// takes a frame only when a second one follows, as one in 256 would fit by chance. Ten zeros, a line held low, say nothing.
class KissDecoder {
 public:
  explicit KissDecoder(unsigned poles) : poles_(poles) {}

  void push(uint8_t byte) {
    if (size_ == kKept) slide(1);
    bytes_[size_++] = byte;
  }

  // The next frame of what has been pushed, if there is one; ask until there is none.
  bool next(EscTelemetry& telemetry) {
    while (size_ >= (in_step_ ? kBytes : 2 * kBytes)) {
      const bool good = fits(bytes_) && (in_step_ || fits(bytes_ + kBytes));
      if (!good) {
        if (!in_step_) slide(1);
        in_step_ = false;
        continue;
      }
      in_step_ = true;
      telemetry.temperature_c = static_cast<int8_t>(bytes_[0]);
      telemetry.voltage_v = word(1) * 0.01f;
      telemetry.current_a = word(3) * 0.01f;
      telemetry.consumed_mah = word(5);
      telemetry.rpm = poles_ ? word(7) * 200.0f / static_cast<float>(poles_) : 0.0f;
      slide(kBytes);
      return true;
    }
    return false;
  }

 private:
  static constexpr size_t kBytes = 10;
  static constexpr size_t kKept = 3 * kBytes;
  static bool fits(const uint8_t* frame) {
    bool empty = true;
    for (size_t i = 0; i < kBytes; ++i) empty = empty && frame[i] == 0;
    return !empty && crc8(frame, kBytes - 1) == frame[kBytes - 1];
  }
  void slide(size_t count) {
    size_ -= count;
    for (size_t i = 0; i < size_; ++i) bytes_[i] = bytes_[i + count];
  }
  float word(size_t at) const { return static_cast<float>(bytes_[at] << 8 | bytes_[at + 1]); }

  uint8_t bytes_[kKept] = {0};
  size_t size_ = 0;
  bool in_step_ = false;
  unsigned poles_;
};

}  // namespace saranga
