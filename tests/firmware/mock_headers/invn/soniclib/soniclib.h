// Declarations only, of the few functions of TDK's public SonicLib API that the sketch calls, for a syntax and type
// check. Nothing of SonicLib itself is here; the firmware is built with the user's own copy.
#pragma once
#include <cstdint>
struct ch_group_t {
  int unused;
};
struct ch_dev_t {
  int unused;
};
struct ch_iq_sample_t {
  int16_t q, i;
};
struct ch_thresholds_t;
struct fw_info_t;
enum ch_odr_t : uint8_t { CH_ODR_FREQ_DIV_8 = 4 };
enum ch_meas_mode_t : uint8_t { CH_MEAS_MODE_ACTIVE = 0 };
enum ch_mode_t : uint8_t { CH_MODE_TRIGGERED_TX_RX = 1, CH_MODE_TRIGGERED_RX_ONLY = 2 };
enum ch_io_mode_t : uint8_t { CH_IO_MODE_BLOCK = 0 };
enum ch_interrupt_type_t : uint8_t { CH_INTERRUPT_TYPE_DATA_RDY = 0 };
constexpr uint8_t CH_DEFAULT_MEAS_NUM = 0;
struct ch_meas_config_t {
  ch_odr_t odr;
  uint16_t meas_period;
  ch_meas_mode_t mode;
};
using ch_fw_init_func_t = uint8_t (*)(ch_dev_t*, fw_info_t**);
uint8_t ch_init(ch_dev_t*, ch_group_t*, uint8_t, ch_fw_init_func_t);
uint8_t ch_group_start(ch_group_t*);
uint8_t ch_sensor_is_connected(ch_dev_t*);
uint32_t ch_get_frequency(ch_dev_t*);
uint16_t ch_get_bandwidth(ch_dev_t*);
uint8_t ch_set_frequency(ch_dev_t*, uint32_t);
const char* ch_get_sensor_id(ch_dev_t*);
void ch_io_int_callback_set(ch_group_t*, void (*)(ch_group_t*, uint8_t, ch_interrupt_type_t));
uint8_t ch_meas_init(ch_dev_t*, uint8_t, const ch_meas_config_t*, const ch_thresholds_t*);
uint8_t ch_meas_add_segment_tx(ch_dev_t*, uint8_t, uint16_t, uint8_t, uint8_t, uint8_t);
uint8_t ch_meas_add_segment_count(ch_dev_t*, uint8_t, uint16_t, uint8_t);
uint8_t ch_meas_add_segment_rx(ch_dev_t*, uint8_t, uint16_t, uint8_t, uint8_t, uint8_t);
uint8_t ch_meas_write_config(ch_dev_t*);
uint8_t ch_set_mode(ch_dev_t*, ch_mode_t);
void ch_group_trigger(ch_group_t*);
uint8_t ch_get_iq_data(ch_dev_t*, ch_iq_sample_t*, uint16_t, uint16_t, ch_io_mode_t);
uint8_t ch_enable_data_validation(ch_dev_t*, int16_t, uint8_t);
