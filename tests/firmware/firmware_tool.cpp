// The firmware's portable code behind stdin and stdout, for the tests: compiled on the host, under sanitizers.
//   decode           wire bytes in; every message that is accepted goes out, encoded anew; counters on stderr
//   fuzz COUNT SEED  corrupted inputs of its own: no false frame, resynchronised at the next
//   deadman          lines "c VALUE TOKEN DEADLINE_MS NOW_US" and "t NOW_US"; answers "EXPIRED VALUE TOKEN"
//   kiss POLES       bytes in; lines of telemetry out
//   hx711 ZERO SCALE lines of 24 bits in hexadecimal; counts and newtons out
//   pulse LOW HIGH   lines of throttle; pulse out
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "dead_man.h"
#include "framing.h"
#include "hx711.h"
#include "kiss.h"
#include "messages.h"

using namespace saranga;

namespace {

Decoder decoder;
Hello hello;
Echo echo;

template <class M>
size_t again(M message, uint8_t* out) {
  return read_message(decoder, message) ? encode(decoder.header, message, out) : 0;
}

// The frame that the decoder holds, as a message and encoded anew; 0 where no such message can be.
size_t reencode(uint8_t* out) {
  switch (decoder.header.type) {
    case kHello: return read_message(decoder, hello) ? encode(decoder.header, hello, out) : 0;
    case kEcho: return read_message(decoder, echo) ? encode(decoder.header, echo, out) : 0;
    case kStatus: return again(Status(), out);
    case kStand: return again(Stand(), out);
    case kFault: return again(Fault(), out);
    case kHelloRequest: return again(HelloRequest(), out);
    case kConfig: return again(Config(), out);
    case kStart: return again(Start(), out);
    case kStop: return again(Stop(), out);
    case kSelfTest: return again(SelfTest(), out);
    case kThrottle: return again(Throttle(), out);
    default: ++decoder.counters.bad_message; return 0;
  }
}

int decode_stdin() {
  static uint8_t out[kMaxFrameBytes];
  int c;
  while ((c = std::getchar()) != EOF)
    if (decoder.feed(static_cast<uint8_t>(c))) {
      const size_t size = reencode(out);
      std::fwrite(out, 1, size, stdout);
    }
  std::fprintf(stderr, "%u %u %u\n", decoder.counters.bad_cobs, decoder.counters.bad_crc,
               decoder.counters.bad_message);
  return 0;
}

uint64_t state = 1;
uint32_t draw(uint32_t below) {  // xorshift64*: the same everywhere
  state ^= state >> 12;
  state ^= state << 25;
  state ^= state >> 27;
  return static_cast<uint32_t>((state * 2685821657736338717ull) >> 33) % below;
}

using Bytes = std::vector<uint8_t>;

Bytes random_frame() {
  static uint8_t out[kMaxFrameBytes];
  Header h;
  h.flags = static_cast<uint8_t>(draw(4));
  h.sensor = static_cast<uint8_t>(draw(256));
  h.sequence = draw(1u << 31);
  h.trigger = draw(1u << 31);
  h.time_us = draw(1u << 31);
  size_t size = 0;
  switch (draw(6)) {
    case 0: {
      echo.fop_hz = 53000.0f;
      echo.n = static_cast<uint16_t>(1 + draw(draw(8) ? 40 : kMaxSamples));
      for (uint16_t k = 0; k < 2 * echo.n; ++k)
        echo.iq[k] = static_cast<int16_t>(draw(3) ? draw(65536) : 0);
      size = encode(h, echo, out);
      break;
    }
    case 1: {
      Throttle m;
      m.value = static_cast<float>(draw(1001)) / 1000.0f;
      m.token = draw(1u << 31);
      m.deadline_ms = static_cast<uint16_t>(1 + draw(5000));
      size = encode(h, m, out);
      break;
    }
    case 2: {
      Fault m;
      m.code = static_cast<uint16_t>(draw(65536));
      m.text.set("over current");
      size = encode(h, m, out);
      break;
    }
    case 3: {
      Stand m;
      m.thrust_n = static_cast<float>(draw(10000)) * 1e-3f;
      m.token = draw(1u << 31);
      size = encode(h, m, out);
      break;
    }
    case 4: {
      Config m;
      m.odr = static_cast<uint8_t>(2 + draw(5));
      m.samples = static_cast<uint16_t>(1 + draw(kMaxSamples));
      size = encode(h, m, out);
      break;
    }
    default: size = encode(h, Stop(), out);
  }
  if (size == 0) std::abort();
  return Bytes(out, out + size);
}

// One to four changes: a bit, a byte, bytes lost, bytes put in, the end cut off, a piece of rubbish.
void corrupt(Bytes& data) {
  for (uint32_t times = 1 + draw(4); times > 0 && !data.empty(); --times) {
    const size_t at = draw(static_cast<uint32_t>(data.size()));
    switch (draw(6)) {
      case 0: data[at] = static_cast<uint8_t>(data[at] ^ 1u << draw(8)); break;
      case 1: data[at] = static_cast<uint8_t>(draw(256)); break;
      case 2: data.erase(data.begin() + static_cast<long>(at),
                         data.begin() + static_cast<long>(at + 1 + draw(static_cast<uint32_t>(data.size() - at))));
              break;
      case 3: data.insert(data.begin() + static_cast<long>(at), 1 + draw(20), static_cast<uint8_t>(draw(256))); break;
      case 4: data.resize(at); break;
      default:
        for (uint32_t k = draw(draw(200) ? 30 : 6000); k > 0; --k) data.push_back(static_cast<uint8_t>(draw(256)));
    }
  }
}

int fuzz(unsigned long count, unsigned long seed) {
  static uint8_t out[kMaxFrameBytes];
  state = seed * 2 + 1;
  unsigned long false_frames = 0, lost = 0, survived = 0;
  for (unsigned long k = 0; k < count; ++k) {
    const Bytes original = random_frame();
    Bytes data = original;
    corrupt(data);
    // The zero ends what the corruption may have left open; what comes after it must be decoded again.
    data.push_back(0);
    for (uint8_t byte : data)
      if (decoder.feed(byte)) {
        const size_t size = reencode(out);
        if (size == 0) continue;
        const bool same = size == original.size() && std::memcmp(out, original.data(), size) == 0;
        survived += same;
        false_frames += !same;
      }
    const Bytes next = random_frame();
    bool heard = false;
    for (uint8_t byte : next)
      if (decoder.feed(byte)) {
        const size_t size = reencode(out);
        heard = size == next.size() && std::memcmp(out, next.data(), size) == 0;
      }
    lost += !heard;
  }
  std::printf("%lu inputs, %lu unharmed, %lu false frames, %lu not resynchronised, %u bad COBS, %u bad CRC, %u bad "
              "messages\n", count, survived, false_frames, lost, decoder.counters.bad_cobs, decoder.counters.bad_crc,
              decoder.counters.bad_message);
  return false_frames || lost ? 1 : 0;
}

int dead_man() {
  DeadMan keeper;
  char kind;
  while (std::scanf(" %c", &kind) == 1) {
    int expired = 0;
    if (kind == 'c') {
      float value;
      unsigned token, deadline, now;
      if (std::scanf("%f %u %u %u", &value, &token, &deadline, &now) != 4) return 2;
      keeper.command(value, token, static_cast<uint16_t>(deadline), now);
    } else {
      unsigned now;
      if (std::scanf("%u", &now) != 1) return 2;
      expired = keeper.expire(now);
    }
    std::printf("%d %.9g %u\n", expired, static_cast<double>(keeper.value()), keeper.token());
  }
  return 0;
}

int kiss(unsigned poles) {
  KissDecoder telemetry_of(poles);
  EscTelemetry t;
  int c;
  while ((c = std::getchar()) != EOF) {
    telemetry_of.push(static_cast<uint8_t>(c));
    while (telemetry_of.next(t))
      std::printf("%.9g %.9g %.9g %.9g %.9g\n", static_cast<double>(t.temperature_c), static_cast<double>(t.voltage_v),
                  static_cast<double>(t.current_a), static_cast<double>(t.consumed_mah), static_cast<double>(t.rpm));
  }
  return 0;
}

int hx711(long zero, float scale) {
  LoadCell cell;
  cell.zero_counts = static_cast<int32_t>(zero);
  cell.counts_per_n = scale;
  unsigned bits;
  while (std::scanf("%x", &bits) == 1) {
    const int32_t counts = hx711_counts(bits);
    std::printf("%ld %.9g\n", static_cast<long>(counts), static_cast<double>(cell.newtons(counts)));
  }
  return 0;
}

int pulse(float low, float high) {
  float throttle;
  while (std::scanf("%f", &throttle) == 1) std::printf("%.9g\n", static_cast<double>(esc_pulse_us(throttle, low, high)));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const std::string what = argc > 1 ? argv[1] : "";
  if (what == "decode") return decode_stdin();
  if (what == "fuzz" && argc == 4) return fuzz(std::strtoul(argv[2], nullptr, 10), std::strtoul(argv[3], nullptr, 10));
  if (what == "deadman") return dead_man();
  if (what == "kiss" && argc == 3) return kiss(static_cast<unsigned>(std::strtoul(argv[2], nullptr, 10)));
  if (what == "hx711" && argc == 4) return hx711(std::strtol(argv[2], nullptr, 10), std::strtof(argv[3], nullptr));
  if (what == "pulse" && argc == 4) return pulse(std::strtof(argv[2], nullptr), std::strtof(argv[3], nullptr));
  std::fprintf(stderr, "usage: decode | fuzz COUNT SEED | deadman | kiss POLES | hx711 ZERO SCALE | pulse LOW HIGH\n");
  return 2;
}
