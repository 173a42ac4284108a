// Rig protocol v1, frames: COBS, CRC-32 as in zlib, 0x00 (layout: saranga/wire.py). No Arduino, no allocation.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

namespace saranga {

constexpr uint8_t kVersion = 1;
constexpr uint8_t kAllSensors = 255;
constexpr size_t kHeaderBytes = 16;
constexpr size_t kCrcBytes = 4;
constexpr size_t kMaxSamples = 680;
constexpr size_t kMaxBodyBytes = kHeaderBytes + 8 + 4 * kMaxSamples;  // the longest, an ECHO of 680 pairs
constexpr size_t kMaxFrameBytes = 4096;                               // longest run without a zero that is kept

struct Header {
  uint8_t type = 0;
  uint8_t flags = 0;
  uint8_t sensor = kAllSensors;
  uint32_t sequence = 0;
  uint32_t trigger = 0;
  uint32_t time_us = 0;
};

inline uint32_t crc32(const uint8_t* data, size_t size) {
  uint32_t crc = 0xFFFFFFFFu;
  for (size_t i = 0; i < size; ++i) {
    crc ^= data[i];
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
  }
  return crc ^ 0xFFFFFFFFu;
}

// Bytes needed for `size` bytes in COBS, the closing zero included.
constexpr size_t cobs_capacity(size_t size) { return size + size / 254 + 2; }

// COBS and the closing zero; `out` must hold cobs_capacity(size). Returns the bytes written.
inline size_t cobs_encode(const uint8_t* data, size_t size, uint8_t* out) {
  size_t code_at = 0, at = 1;
  uint8_t code = 1;
  for (size_t i = 0; i < size; ++i) {
    if (data[i] == 0) {
      out[code_at] = code;
      code_at = at++;
      code = 1;
      continue;
    }
    out[at++] = data[i];
    if (++code == 0xFF && i + 1 < size) {
      out[code_at] = code;
      code_at = at++;
      code = 1;
    }
  }
  out[code_at] = code;
  out[at++] = 0;
  return at;
}

// In place, the closing zero left out. Returns false where a block is longer than what is left.
inline bool cobs_decode(uint8_t* data, size_t size, size_t* decoded) {
  size_t in = 0, out = 0;
  while (in < size) {
    const uint8_t code = data[in++];
    if (code == 0 || static_cast<size_t>(code - 1) > size - in) return false;
    for (uint8_t k = 1; k < code; ++k) data[out++] = data[in++];
    if (code != 0xFF && in < size) data[out++] = 0;
  }
  *decoded = out;
  return true;
}

// Little-endian numbers into a buffer that knows its end; `ok` turns false instead of writing past it.
class Writer {
 public:
  Writer(uint8_t* data, size_t capacity) : data_(data), capacity_(capacity) {}
  void u8(uint8_t v) { raw(&v, 1); }
  void u16(uint16_t v) {
    const uint8_t b[2] = {static_cast<uint8_t>(v), static_cast<uint8_t>(v >> 8)};
    raw(b, 2);
  }
  void u32(uint32_t v) {
    const uint8_t b[4] = {static_cast<uint8_t>(v), static_cast<uint8_t>(v >> 8), static_cast<uint8_t>(v >> 16),
                          static_cast<uint8_t>(v >> 24)};
    raw(b, 4);
  }
  void f32(float v) {
    uint32_t bits;
    std::memcpy(&bits, &v, 4);
    u32(bits);
  }
  // u8 length and UTF-8; a text longer than `most` fails.
  void text(const char* s, size_t most) {
    const size_t length = std::strlen(s);
    if (length > most) {
      ok = false;
      return;
    }
    u8(static_cast<uint8_t>(length));
    raw(reinterpret_cast<const uint8_t*>(s), length);
  }
  void raw(const uint8_t* bytes, size_t count) {
    if (!ok || count > capacity_ - size) {
      ok = false;
      return;
    }
    if (count) std::memcpy(data_ + size, bytes, count);
    size += count;
  }
  size_t size = 0;
  bool ok = true;

 private:
  uint8_t* data_;
  size_t capacity_;
};

class Reader {
 public:
  Reader(const uint8_t* data, size_t size) : data_(data), size_(size) {}
  uint8_t u8() { return take(1) ? data_[at_ - 1] : 0; }
  uint16_t u16() { return static_cast<uint16_t>(take(2) ? data_[at_ - 2] | data_[at_ - 1] << 8 : 0); }
  uint32_t u32() {
    if (!take(4)) return 0;
    const uint8_t* b = data_ + at_ - 4;
    return static_cast<uint32_t>(b[0]) | static_cast<uint32_t>(b[1]) << 8 | static_cast<uint32_t>(b[2]) << 16 |
           static_cast<uint32_t>(b[3]) << 24;
  }
  float f32() {
    const uint32_t bits = u32();
    float v;
    std::memcpy(&v, &bits, 4);
    return v;
  }
  const uint8_t* raw(size_t count) { return take(count) ? data_ + at_ - count : nullptr; }
  size_t left() const { return size_ - at_; }
  bool ok = true;

 private:
  bool take(size_t count) {
    if (!ok || count > size_ - at_) {
      ok = false;
      return false;
    }
    at_ += count;
    return true;
  }
  const uint8_t* data_;
  size_t size_;
  size_t at_ = 0;
};

// Header and payload to wire bytes. `out` must hold kMaxFrameBytes. Returns 0 where the payload is too long.
inline size_t encode_frame(const Header& h, const uint8_t* payload, size_t payload_size, uint8_t* out) {
  static_assert(cobs_capacity(kMaxBodyBytes + kCrcBytes) <= kMaxFrameBytes, "the longest frame fits");
  if (payload_size > kMaxBodyBytes - kHeaderBytes) return 0;
  uint8_t body[kMaxBodyBytes + kCrcBytes];
  Writer w(body, sizeof body);
  w.u8(kVersion);
  w.u8(h.type);
  w.u8(h.flags);
  w.u8(h.sensor);
  w.u32(h.sequence);
  w.u32(h.trigger);
  w.u32(h.time_us);
  w.raw(payload, payload_size);
  w.u32(crc32(body, w.size));
  return w.ok ? cobs_encode(body, w.size, out) : 0;
}

struct LinkCounters {
  uint32_t bad_cobs = 0;
  uint32_t bad_crc = 0;
  uint32_t bad_message = 0;  // right CRC, but not of this protocol version, or contents that cannot be
};

// Wire bytes to frames, a byte at a time. Whatever the bytes, it holds kMaxFrameBytes and never reads past them.
class Decoder {
 public:
  // True when a whole frame has come with this byte: then `header`, `payload` and `payload_size` are it, until the
  // next call. What its contents mean is for messages.h.
  bool feed(uint8_t byte) {
    if (byte != 0) {
      if (skipping_) return false;
      if (size_ == kMaxFrameBytes) {
        ++counters.bad_cobs;
        skipping_ = true;
        size_ = 0;
        return false;
      }
      buffer_[size_++] = byte;
      return false;
    }
    const size_t size = size_;
    const bool skipped = skipping_;
    size_ = 0;
    skipping_ = false;
    return !skipped && size != 0 && complete(size);
  }

  Header header;
  const uint8_t* payload = nullptr;
  size_t payload_size = 0;
  LinkCounters counters;

 private:
  bool complete(size_t size) {
    size_t body = 0;
    if (!cobs_decode(buffer_, size, &body)) {
      ++counters.bad_cobs;
      return false;
    }
    if (body < kHeaderBytes + kCrcBytes) {
      ++counters.bad_crc;
      return false;
    }
    Reader tail(buffer_ + body - kCrcBytes, kCrcBytes);
    if (crc32(buffer_, body - kCrcBytes) != tail.u32()) {
      ++counters.bad_crc;
      return false;
    }
    Reader r(buffer_, body);
    if (r.u8() != kVersion) {
      ++counters.bad_message;
      return false;
    }
    header.type = r.u8();
    header.flags = r.u8();
    header.sensor = r.u8();
    header.sequence = r.u32();
    header.trigger = r.u32();
    header.time_us = r.u32();
    payload = buffer_ + kHeaderBytes;
    payload_size = body - kHeaderBytes - kCrcBytes;
    return true;
  }

  uint8_t buffer_[kMaxFrameBytes];
  size_t size_ = 0;
  bool skipping_ = false;
};

}  // namespace saranga
