// Declarations only (see soniclib.h above it).
#pragma once
#include "../../soniclib.h"
uint8_t icu_gpt_init(ch_dev_t*, fw_info_t**);
uint8_t icu_gpt_set_static_filter(ch_dev_t*, uint8_t, uint16_t);
