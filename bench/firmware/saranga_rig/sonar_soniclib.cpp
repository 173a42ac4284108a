// SonicLib 4.x (TDK InvenSense) behind sonar.h. SonicLib is not part of this project: its licence binds it to TDK's
// sensors. Put your own copy, with a board file (chbsp) for the Teensy 4.1, into the Arduino libraries folder.
//
// Written against its public API (soniclib.h 4.9.0, migration guide, AN-000175) and not yet run on a sensor: what is
// marked TO CONFIRM rests on documents alone.
#include "sonar.h"

#include <Arduino.h>
#include <invn/soniclib/chirp_bsp.h>
#include <invn/soniclib/sensor_fw/icu_gpt/icu_gpt.h>
#include <invn/soniclib/soniclib.h>

#include "config.h"

namespace {

ch_group_t group;
ch_dev_t devices[config::kSensors];
ch_iq_sample_t samples[saranga::kMaxSamples];
volatile uint32_t ready_bits = 0;
uint32_t triggered_us = 0;
uint8_t odr = 5;
uint16_t count = 340;
uint16_t ring_down = 20;
uint8_t mode = 0;

constexpr uint16_t kMostSamples = 340;  // general-purpose firmware
constexpr int16_t kSeed = 0;
constexpr uint32_t kAll = (1u << config::kSensors) - 1u;

void on_interrupt(ch_group_t*, uint8_t number, ch_interrupt_type_t what) {
  if (what == CH_INTERRUPT_TYPE_DATA_RDY) ready_bits = ready_bits | 1u << number;
}

// The burst for the transmitter, a pause of the same length for the others (AN-000175, count segments), then receive.
// Receive only: the pause for all.
bool program(uint8_t number) {
  ch_dev_t* dev = &devices[number];
  ch_meas_config_t meas = {};
  meas.odr = static_cast<ch_odr_t>(odr);
  meas.meas_period = 0;
  meas.mode = CH_MEAS_MODE_ACTIVE;
  uint8_t wrong = ch_meas_init(dev, CH_DEFAULT_MEAS_NUM, &meas, nullptr);
  if (number == config::kTransmitter && mode == 0)
    wrong |= ch_meas_add_segment_tx(dev, CH_DEFAULT_MEAS_NUM, config::kTransmitCycles, config::kTransmitWidth,
                                    config::kTransmitPhase, 0);
  else
    wrong |= ch_meas_add_segment_count(dev, CH_DEFAULT_MEAS_NUM, config::kTransmitCycles, 0);
  wrong |= ch_meas_add_segment_rx(dev, CH_DEFAULT_MEAS_NUM, count, 0, 0, 1);
  // TO CONFIRM: the static filter is what the data sheet calls ring-down cancel.
  wrong |= icu_gpt_set_static_filter(dev, CH_DEFAULT_MEAS_NUM, mode == 0 ? ring_down : 0);
  wrong |= ch_meas_write_config(dev);
  wrong |= ch_set_mode(dev, number == config::kTransmitter && mode == 0 ? CH_MODE_TRIGGERED_TX_RX
                                                                         : CH_MODE_TRIGGERED_RX_ONLY);
  return wrong == 0;
}

bool program_all() {
  bool fine = true;
  for (uint8_t k = 0; k < config::kSensors; ++k) fine = program(k) && fine;
  return fine;
}

uint16_t read_pairs(uint8_t sensor, int16_t* iq, uint16_t most) {
  const uint16_t n = count < most ? count : most;
  if (ch_get_iq_data(&devices[sensor], samples, 0, n, CH_IO_MODE_BLOCK) != 0) return 0;
  for (uint16_t k = 0; k < n; ++k) {
    iq[2 * k] = samples[k].q;
    iq[2 * k + 1] = samples[k].i;
  }
  return n;
}

}  // namespace

bool sonar_begin(saranga::Hello& hello, const char** why) {
  chbsp_board_init(&group);
  uint8_t wrong = 0;
  for (uint8_t k = 0; k < config::kSensors; ++k) wrong |= ch_init(&devices[k], &group, k, icu_gpt_init);
  // Finds the sensors, loads their firmware, calibrates the RTC.
  if (wrong != 0 || ch_group_start(&group) != 0) {
    *why = "sensors do not start: check supply, SPI and the board file";
    return false;
  }
  uint32_t sum_hz = 0;
  for (uint8_t k = 0; k < config::kSensors; ++k) {
    if (!ch_sensor_is_connected(&devices[k])) {
      *why = "a sensor is missing: check its plug";
      return false;
    }
    sum_hz += ch_get_frequency(&devices[k]);
  }
  for (uint8_t k = 0; k < config::kSensors; ++k) ch_set_frequency(&devices[k], sum_hz / config::kSensors);
  ch_io_int_callback_set(&group, on_interrupt);
  hello.count = config::kSensors;
  for (uint8_t k = 0; k < config::kSensors; ++k) {
    saranga::SensorInfo& s = hello.sensors[k];
    s.sensor = k;
    s.role = config::kRoles[k];
    s.transmits = k == config::kTransmitter;
    s.fop_hz = static_cast<float>(ch_get_frequency(&devices[k]));
    s.bandwidth_hz = static_cast<float>(ch_get_bandwidth(&devices[k]));
    s.serial.set(ch_get_sensor_id(&devices[k]));
    if (s.serial.length > 32) s.serial.length = 32;
  }
  if (!program_all()) {
    *why = "the measurement cannot be programmed";
    return false;
  }
  return true;
}

bool sonar_configure(const saranga::Config& config) {
  if (config.samples > kMostSamples) return false;
  const uint8_t old_odr = odr;
  const uint16_t old_count = count, old_ring_down = ring_down;
  odr = config.odr;
  count = config.samples;
  ring_down = config.ring_down_samples;
  if (program_all()) return true;
  odr = old_odr;
  count = old_count;
  ring_down = old_ring_down;
  program_all();
  return false;
}

bool sonar_mode(uint8_t wanted) {
  if (wanted == mode) return true;
  mode = wanted;
  return program_all();
}

void sonar_trigger() {
  ready_bits = 0;
  triggered_us = micros();
  ch_group_trigger(&group);
}

bool sonar_ready(uint32_t late_us) { return ready_bits == kAll || micros() - triggered_us >= late_us; }

uint16_t sonar_read(uint8_t sensor, int16_t* iq, uint16_t most) {
  return ready_bits & 1u << sensor ? read_pairs(sensor, iq, most) : 0;
}

float sonar_fop_hz(uint8_t sensor) { return static_cast<float>(ch_get_frequency(&devices[sensor])); }

uint16_t sonar_link_test(uint8_t sensor, int16_t* iq, uint16_t most) {
  // TO CONFIRM: in data validation mode every int16 is one more than the last, beginning with the seed.
  if (ch_enable_data_validation(&devices[sensor], kSeed, 1) != 0) return 0;
  sonar_trigger();
  while (!sonar_ready(100000)) {
  }
  const uint16_t n = ready_bits & 1u << sensor ? read_pairs(sensor, iq, most) : 0;
  ch_enable_data_validation(&devices[sensor], kSeed, 0);
  for (uint16_t k = 0; k < n; ++k) {
    const int first = kSeed + 2 * k;
    const bool right = iq[2 * k] == first && iq[2 * k + 1] == first + 1;
    iq[2 * k] = static_cast<int16_t>(right ? k : -1);
    iq[2 * k + 1] = static_cast<int16_t>(right ? -static_cast<int>(k) : 1);
  }
  return n;
}

uint8_t sonar_self_test(uint8_t sensor) {
  // TO CONFIRM: the sensor's BIST ran in ch_group_start; one that failed it is not connected any more.
  return ch_sensor_is_connected(&devices[sensor]) ? 1 : 2;
}
