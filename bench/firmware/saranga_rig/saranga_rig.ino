// Sonar rig and thrust stand on a Teensy 4.1, rig protocol v1 over USB (docs/firmware.md).
//
// Not yet run on hardware. Protocol, dead-man, telemetry and load cell are tested on the host (tests/firmware); this
// file only joins them to pins. The dead-man runs in a timer interrupt: a loop that hangs does not hold the throttle.
#include <Arduino.h>

#include "config.h"
#include "sonar.h"
#include "src/dead_man.h"
#include "src/framing.h"
#include "src/hx711.h"
#include "src/kiss.h"
#include "src/messages.h"

using namespace saranga;

namespace {

constexpr uint16_t kUnsupported = 1, kBadConfig = 2, kDeadMan = 3, kSonar = 4;
constexpr uint32_t kStandPeriodUs = 20000, kStatusPeriodUs = 1000000;
constexpr uint32_t kEscHz = 400;

Decoder decoder;
Hello hello;
Echo echo;
DeadMan dead_man;
KissDecoder esc(config::kMotorPoles);
IntervalTimer guard;
uint8_t wire[kMaxFrameBytes];

uint32_t sequence_rig = 0, sequences[3] = {0, 0, 0};
uint32_t trigger_number = 0, overruns = 0, cycles = 0;
bool running = false, waiting = false, sonar_works = false;
uint8_t mode = 0, odr = 5;
uint32_t period_us = 25600, next_us = 0, triggered_us = 0;
uint32_t stand_us = 0, status_us = 0;
bool overrun[3] = {false, false, false};
float thrust_n = NAN;
EscTelemetry telemetry;
uint32_t telemetry_ms = 0;
bool has_telemetry = false;
volatile bool expired = false;

void write_esc() {
  const float us = esc_pulse_us(dead_man.value(), config::kEscLowUs, config::kEscHighUs);
  analogWrite(config::kEscPin, static_cast<int>(us * (kEscHz * 65536e-6f)));
}

// Every millisecond, above the loop: whatever hangs, the motor idles at its deadline.
void on_guard() {
  if (dead_man.expire(micros())) {
    expired = true;
    write_esc();
  }
}

template <class M>
void send(const M& message, uint8_t sensor = kAllSensors, uint32_t time_us = micros(), uint8_t flags = 0) {
  Header h;
  h.flags = flags;
  h.sensor = sensor;
  h.sequence = sensor == kAllSensors ? sequence_rig++ : sequences[sensor]++;
  h.trigger = trigger_number;
  h.time_us = time_us;
  const size_t size = encode(h, message, wire);
  if (size) Serial.write(wire, size);
}

void complain(uint16_t code, const char* text) {
  Fault fault;
  fault.code = code;
  fault.text.set(text);
  send(fault);
}

void say_stand() {
  if (!config::kHasStand) return;
  Stand stand;
  stand.thrust_n = thrust_n;
  if (has_telemetry && millis() - telemetry_ms < config::kTelemetryGapMs) {
    stand.rpm = telemetry.rpm;
    stand.voltage_v = telemetry.voltage_v;
    stand.current_a = telemetry.current_a;
    stand.esc_temperature_c = telemetry.temperature_c;
  }
  noInterrupts();
  stand.throttle = dead_man.value();
  stand.token = dead_man.token();
  interrupts();
  send(stand);
}

void say_status() {
  Status status;
  status.overruns = overruns;
  status.host_errors = decoder.counters.bad_cobs + decoder.counters.bad_crc + decoder.counters.bad_message;
  status.cycles = cycles;
  status.state = !running ? 0 : mode == 0 ? 1 : 2;
  send(status);
}

void link_test(uint8_t wanted) {
  for (uint8_t k = 0; k < config::kSensors; ++k) {
    if (wanted != kAllSensors && wanted != k) continue;
    echo.n = sonar_link_test(k, echo.iq, kMaxSamples);
    if (echo.n == 0) continue;
    echo.fop_hz = sonar_fop_hz(k);
    echo.odr = odr;
    echo.mode = mode;
    const uint32_t number = trigger_number;
    trigger_number = 0;
    send(echo, k);
    trigger_number = number;
  }
}

void take_throttle() {
  Throttle throttle;
  if (!read_message(decoder, throttle)) return;
  if (!config::kHasThrottle) {
    complain(kUnsupported, "THROTTLE: this device has none");
    return;
  }
  noInterrupts();
  dead_man.command(throttle.value, throttle.token, throttle.deadline_ms, micros());
  write_esc();
  interrupts();
  say_stand();  // at once: the host waits for the readback
}

void take_message() {
  const uint8_t sensor = decoder.header.sensor;
  switch (decoder.header.type) {
    case kHelloRequest: {
      HelloRequest m;
      if (read_message(decoder, m)) send(hello);
      break;
    }
    case kConfig: {
      Config m;
      if (!read_message(decoder, m)) break;
      if (sensor != kAllSensors) {
        complain(kBadConfig, "CONFIG of one sensor: send it to all (255)");
      } else if (!sonar_works || !sonar_configure(m)) {
        complain(kBadConfig, "CONFIG refused by the sensors: at most 340 samples");
      } else {
        odr = m.odr;
      }
      break;
    }
    case kStart: {
      Start m;
      if (!read_message(decoder, m)) break;
      if (!sonar_works || !sonar_mode(m.mode)) {
        complain(kSonar, "START: the sensors do not work");
        break;
      }
      mode = m.mode;
      period_us = static_cast<uint32_t>(1e6f / m.rate_hz + 0.5f);
      running = true;
      waiting = false;
      next_us = micros() + period_us;
      break;
    }
    case kStop: {
      Stop m;
      if (read_message(decoder, m)) running = waiting = false;
      break;
    }
    case kSelfTest: {
      SelfTest m;
      if (!read_message(decoder, m)) break;
      if (running) {
        complain(kUnsupported, "SELF TEST: send STOP first");
      } else if (m.kind == 1) {
        if (sonar_works) link_test(sensor);
      } else {
        for (uint8_t k = 0; k < hello.count; ++k)
          if (sensor == kAllSensors || sensor == k) hello.sensors[k].self_test = sonar_self_test(k);
        send(hello);
      }
      break;
    }
    case kThrottle: take_throttle(); break;
    default: complain(kUnsupported, "this message is none for a device");
  }
}

void measure() {
  const uint32_t now = micros();
  if (waiting) {
    if (!sonar_ready(period_us < 100000 ? period_us : 100000)) return;
    waiting = false;
    for (uint8_t k = 0; k < config::kSensors; ++k) {
      echo.n = sonar_read(k, echo.iq, kMaxSamples);
      if (echo.n == 0) {
        overrun[k] = true;
        ++overruns;
        continue;
      }
      echo.fop_hz = sonar_fop_hz(k);
      echo.odr = odr;
      echo.mode = mode;
      send(echo, k, triggered_us, overrun[k] ? kFlagOverrun : 0);
      overrun[k] = false;
    }
    ++cycles;
    return;
  }
  if (static_cast<int32_t>(now - next_us) < 0) return;
  // Cycles that should long have been are lost, and counted.
  const uint32_t lost = (now - next_us) / period_us;
  if (lost) {
    overruns += lost;
    trigger_number += lost;
    for (bool& flag : overrun) flag = true;
  }
  next_us += (lost + 1) * period_us;
  ++trigger_number;
  triggered_us = now;
  sonar_trigger();
  waiting = true;
}

// 24 bits by hand; 25 pulses choose channel A, gain 128. Interrupts off while the clock is high: 60 us mean power-down.
void read_load_cell() {
  if (!config::kHasStand || digitalReadFast(config::kHx711Data) == HIGH) return;
  uint32_t bits = 0;
  for (int k = 0; k < 25; ++k) {
    noInterrupts();
    digitalWriteFast(config::kHx711Clock, HIGH);
    delayMicroseconds(1);
    const uint32_t bit = digitalReadFast(config::kHx711Data) == HIGH ? 1u : 0u;
    digitalWriteFast(config::kHx711Clock, LOW);
    interrupts();
    delayMicroseconds(1);
    if (k < 24) bits = bits << 1 | bit;
  }
  const LoadCell cell = {config::kZeroCounts, config::kCountsPerNewton};
  thrust_n = cell.newtons(hx711_counts(bits));
}

}  // namespace

void setup() {
  if (config::kHasThrottle) {
    pinMode(config::kEscPin, OUTPUT);
    analogWriteResolution(16);
    analogWriteFrequency(config::kEscPin, kEscHz);
    write_esc();  // idle pulses from the first moment on
    guard.begin(on_guard, 1000);
    Serial1.begin(115200);
  }
  if (config::kHasStand) {
    pinMode(config::kHx711Data, INPUT);
    pinMode(config::kHx711Clock, OUTPUT);
    digitalWriteFast(config::kHx711Clock, LOW);
  }
  Serial.begin(115200);  // USB: the rate is ignored
  hello.firmware.set(config::kFirmware);
  hello.capabilities = static_cast<uint8_t>((config::kHasStand ? 1 : 0) | (config::kHasThrottle ? 2 : 0));
  const char* why = "";
  sonar_works = sonar_begin(hello, &why);
  send(hello, kAllSensors, micros(), kFlagBoot);
  if (!sonar_works) complain(kSonar, why);
  stand_us = status_us = micros();
}

void loop() {
  while (Serial.available() > 0)
    if (decoder.feed(static_cast<uint8_t>(Serial.read()))) take_message();
  if (expired) {
    expired = false;
    say_stand();
    complain(kDeadMan, "throttle deadline passed without a new command: idle");
  }
  while (config::kHasThrottle && Serial1.available() > 0) {
    esc.push(static_cast<uint8_t>(Serial1.read()));
    while (esc.next(telemetry)) {
      has_telemetry = true;
      telemetry_ms = millis();
    }
  }
  read_load_cell();
  if (running) measure();
  const uint32_t now = micros();
  if (now - stand_us >= kStandPeriodUs) {
    stand_us += kStandPeriodUs;
    say_stand();
  }
  if (now - status_us >= kStatusPeriodUs) {
    status_us += kStatusPeriodUs;
    say_status();
  }
}
