// Rig protocol v1, what the frames say: each message both ways, with the limits of saranga/payloads.py.
#pragma once

#include <cmath>
#include <initializer_list>

#include "framing.h"

namespace saranga {

enum Type : uint8_t {
  kHello = 0x01,
  kEcho = 0x02,
  kStatus = 0x03,
  kStand = 0x04,
  kFault = 0x05,
  kHelloRequest = 0x81,
  kConfig = 0x82,
  kStart = 0x83,
  kStop = 0x84,
  kSelfTest = 0x85,
  kThrottle = 0x86,
};

constexpr uint8_t kFlagBoot = 1;     // HELLO
constexpr uint8_t kFlagOverrun = 1;  // ECHO
constexpr size_t kMaxSensors = 16;
constexpr size_t kMaxText = 200;

// A text that is carried with its length; never longer than `kMaxText`, always ended by a zero.
struct Text {
  uint8_t length = 0;
  char bytes[kMaxText + 1] = {0};
  void set(const char* s) {
    length = 0;
    while (s[length] != 0 && length < kMaxText) {
      bytes[length] = s[length];
      ++length;
    }
    bytes[length] = 0;
  }
};

namespace detail {
inline bool within(float v, float low, float high) { return v >= low && v <= high; }  // NaN is not

// Well-formed UTF-8, as Python's decoder takes it: no overlong forms, no surrogates, nothing above U+10FFFF.
inline bool utf8(const uint8_t* s, size_t n) {
  size_t i = 0;
  while (i < n) {
    const uint8_t c = s[i++];
    size_t more;
    uint8_t low = 0x80, high = 0xBF;
    if (c < 0x80) {
      continue;
    } else if (c >= 0xC2 && c <= 0xDF) {
      more = 1;
    } else if (c >= 0xE0 && c <= 0xEF) {
      more = 2;
      if (c == 0xE0) low = 0xA0;
      if (c == 0xED) high = 0x9F;
    } else if (c >= 0xF0 && c <= 0xF4) {
      more = 3;
      if (c == 0xF0) low = 0x90;
      if (c == 0xF4) high = 0x8F;
    } else {
      return false;
    }
    for (; more > 0; --more, low = 0x80, high = 0xBF) {
      if (i == n || s[i] < low || s[i] > high) return false;
      ++i;
    }
  }
  return true;
}

inline bool read_text(Reader& r, Text& text, size_t most) {
  const uint8_t length = r.u8();
  const uint8_t* bytes = r.raw(length);
  if (!r.ok || length > most || (length && !utf8(bytes, length))) return false;
  text.length = length;
  if (length) std::memcpy(text.bytes, bytes, length);
  text.bytes[length] = 0;
  return true;
}

inline void write_text(Writer& w, const Text& text, size_t most) {
  if (text.length > most) w.ok = false;
  w.u8(text.length);
  w.raw(reinterpret_cast<const uint8_t*>(text.bytes), text.length);
}
}  // namespace detail

struct SensorInfo {
  uint8_t sensor = 0;
  uint8_t role = 255;     // 0 left, 1 right, 2 down, 255 none
  uint8_t self_test = 0;  // 0 untested, 1 pass, 2 fail
  uint8_t transmits = 0;
  float fop_hz = 0;
  float bandwidth_hz = 0;
  Text serial;
};

struct Hello {
  static constexpr uint8_t type = kHello;
  Text firmware;
  uint8_t capabilities = 0;  // bit 0 stand, bit 1 throttle
  uint8_t count = 0;
  SensorInfo sensors[kMaxSensors];

  bool valid() const {
    if (capabilities > 3 || count > kMaxSensors) return false;
    for (uint8_t k = 0; k < count; ++k) {
      const SensorInfo& s = sensors[k];
      if (s.sensor == kAllSensors || !(s.role <= 2 || s.role == 255) || s.self_test > 2 || s.transmits > 1)
        return false;
      if (!detail::within(s.fop_hz, 20e3f, 200e3f) || !(s.bandwidth_hz > 0.0f && s.bandwidth_hz <= 100e3f))
        return false;
      for (uint8_t j = 0; j < k; ++j)
        if (sensors[j].sensor == s.sensor || (s.role != 255 && sensors[j].role == s.role)) return false;
    }
    return true;
  }
  bool read(Reader& r) {
    if (!detail::read_text(r, firmware, 64)) return false;
    capabilities = r.u8();
    count = r.u8();
    if (!r.ok || count > kMaxSensors) return false;
    for (uint8_t k = 0; k < count; ++k) {
      SensorInfo& s = sensors[k];
      s.sensor = r.u8();
      s.role = r.u8();
      s.self_test = r.u8();
      s.transmits = r.u8();
      s.fop_hz = r.f32();
      s.bandwidth_hz = r.f32();
      if (!detail::read_text(r, s.serial, 32)) return false;
    }
    return true;
  }
  void write(Writer& w) const {
    detail::write_text(w, firmware, 64);
    w.u8(capabilities);
    w.u8(count);
    for (uint8_t k = 0; k < count && k < kMaxSensors; ++k) {
      const SensorInfo& s = sensors[k];
      w.u8(s.sensor);
      w.u8(s.role);
      w.u8(s.self_test);
      w.u8(s.transmits);
      w.f32(s.fop_hz);
      w.f32(s.bandwidth_hz);
      detail::write_text(w, s.serial, 32);
    }
  }
};

struct Echo {
  static constexpr uint8_t type = kEcho;
  float fop_hz = 0;
  uint8_t odr = 6;
  uint8_t mode = 0;
  uint16_t n = 0;
  int16_t iq[2 * kMaxSamples] = {0};  // Q first

  bool valid() const {
    return detail::within(fop_hz, 20e3f, 200e3f) && odr >= 2 && odr <= 6 && mode <= 1 && n >= 1 && n <= kMaxSamples;
  }
  bool read(Reader& r) {
    fop_hz = r.f32();
    odr = r.u8();
    mode = r.u8();
    n = r.u16();
    if (!r.ok || n > kMaxSamples) return false;
    for (uint16_t k = 0; k < 2 * n; ++k) iq[k] = static_cast<int16_t>(r.u16());
    return true;
  }
  void write(Writer& w) const {
    w.f32(fop_hz);
    w.u8(odr);
    w.u8(mode);
    w.u16(n);
    for (uint16_t k = 0; k < 2 * n && k < 2 * kMaxSamples; ++k) w.u16(static_cast<uint16_t>(iq[k]));
  }
};

struct Status {
  static constexpr uint8_t type = kStatus;
  uint32_t overruns = 0, host_errors = 0, cycles = 0;
  float temperature_c = NAN;
  uint8_t state = 0;  // 0 idle, 1 transmit/receive, 2 receive only

  bool valid() const { return state <= 2; }
  bool read(Reader& r) {
    overruns = r.u32();
    host_errors = r.u32();
    cycles = r.u32();
    temperature_c = r.f32();
    state = r.u8();
    return true;
  }
  void write(Writer& w) const {
    w.u32(overruns);
    w.u32(host_errors);
    w.u32(cycles);
    w.f32(temperature_c);
    w.u8(state);
  }
};

struct Stand {
  static constexpr uint8_t type = kStand;
  float thrust_n = NAN, torque_n_m = NAN, rpm = NAN, voltage_v = NAN, current_a = NAN, esc_temperature_c = NAN,
        motor_temperature_c = NAN, throttle = 0;
  uint32_t token = 0;

  bool valid() const { return true; }
  bool read(Reader& r) {
    for (float* f : {&thrust_n, &torque_n_m, &rpm, &voltage_v, &current_a, &esc_temperature_c, &motor_temperature_c,
                     &throttle})
      *f = r.f32();
    token = r.u32();
    return true;
  }
  void write(Writer& w) const {
    for (float f : {thrust_n, torque_n_m, rpm, voltage_v, current_a, esc_temperature_c, motor_temperature_c, throttle})
      w.f32(f);
    w.u32(token);
  }
};

struct Fault {
  static constexpr uint8_t type = kFault;
  uint16_t code = 0;
  uint8_t latched = 0;
  Text text;

  bool valid() const { return latched <= 1; }
  bool read(Reader& r) {
    code = r.u16();
    latched = r.u8();
    return detail::read_text(r, text, kMaxText);
  }
  void write(Writer& w) const {
    w.u16(code);
    w.u8(latched);
    detail::write_text(w, text, kMaxText);
  }
};

struct HelloRequest {
  static constexpr uint8_t type = kHelloRequest;
  bool valid() const { return true; }
  bool read(Reader&) { return true; }
  void write(Writer&) const {}
};

struct Config {
  static constexpr uint8_t type = kConfig;
  uint8_t odr = 0;
  uint16_t samples = 0, ring_down_samples = 0;

  bool valid() const {
    return odr >= 2 && odr <= 6 && samples >= 1 && samples <= kMaxSamples && ring_down_samples <= kMaxSamples;
  }
  bool read(Reader& r) {
    odr = r.u8();
    samples = r.u16();
    ring_down_samples = r.u16();
    return true;
  }
  void write(Writer& w) const {
    w.u8(odr);
    w.u16(samples);
    w.u16(ring_down_samples);
  }
};

struct Start {
  static constexpr uint8_t type = kStart;
  uint8_t mode = 0;
  float rate_hz = 0;

  // 0.1 as the host's double has it: the f32 next to it is just above.
  bool valid() const { return mode <= 1 && static_cast<double>(rate_hz) >= 0.1 && rate_hz <= 200.0f; }
  bool read(Reader& r) {
    mode = r.u8();
    rate_hz = r.f32();
    return true;
  }
  void write(Writer& w) const {
    w.u8(mode);
    w.f32(rate_hz);
  }
};

struct Stop {
  static constexpr uint8_t type = kStop;
  bool valid() const { return true; }
  bool read(Reader&) { return true; }
  void write(Writer&) const {}
};

struct SelfTest {
  static constexpr uint8_t type = kSelfTest;
  uint8_t kind = 0;  // 0 built-in, 1 link test
  bool valid() const { return kind <= 1; }
  bool read(Reader& r) {
    kind = r.u8();
    return true;
  }
  void write(Writer& w) const { w.u8(kind); }
};

struct Throttle {
  static constexpr uint8_t type = kThrottle;
  float value = 0;
  uint32_t token = 0;
  uint16_t deadline_ms = 0;

  bool valid() const { return detail::within(value, 0.0f, 1.0f) && deadline_ms >= 1 && deadline_ms <= 5000; }
  bool read(Reader& r) {
    value = r.f32();
    token = r.u32();
    deadline_ms = r.u16();
    return true;
  }
  void write(Writer& w) const {
    w.f32(value);
    w.u32(token);
    w.u16(deadline_ms);
  }
};

// The decoder's frame as a message of type M. False, and counted, where its contents cannot be.
template <class M>
bool read_message(Decoder& decoder, M& message) {
  Reader r(decoder.payload, decoder.payload_size);
  if (decoder.header.type == M::type && message.read(r) && r.ok && r.left() == 0 && message.valid()) return true;
  ++decoder.counters.bad_message;
  return false;
}

// Wire bytes of a message; `out` must hold kMaxFrameBytes. 0 where it cannot be sent.
template <class M>
size_t encode(Header header, const M& message, uint8_t* out) {
  uint8_t payload[kMaxBodyBytes] = {0};
  Writer w(payload, sizeof payload);
  message.write(w);
  header.type = M::type;
  return w.ok && message.valid() ? encode_frame(header, payload, w.size, out) : 0;
}

}  // namespace saranga
