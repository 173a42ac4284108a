// The boundary to the sensors: all that the sketch knows of them. `sonar_soniclib.cpp` is the only file that includes
// SonicLib, which is the user's own copy; replace that file and the rest works with other sensors.
#pragma once

#include <cstdint>

#include "src/messages.h"

// Finds, programs and calibrates the sensors, and sets one common fop. Fills the sensors of HELLO. False: `why` says so.
bool sonar_begin(saranga::Hello& hello, const char** why);

// All sensors; samples within what the sensor's firmware holds (340). False: refused, the old setting stays.
bool sonar_configure(const saranga::Config& config);

// 0 transmit/receive, 1 receive only.
bool sonar_mode(uint8_t mode);

// One edge for all sensors. The time is taken here.
void sonar_trigger();

// True once every sensor has measured, or `late_us` after the trigger.
bool sonar_ready(uint32_t late_us);

// The record of one sensor after `sonar_ready`: n pairs, Q first. 0: it did not measure.
uint16_t sonar_read(uint8_t sensor, int16_t* iq, uint16_t most);

// Operating frequency now, Hz.
float sonar_fop_hz(uint8_t sensor);

// What a sensor sends in data validation mode, as pairs Q = n, I = -n where the link is right. 0: nothing.
uint16_t sonar_link_test(uint8_t sensor, int16_t* iq, uint16_t most);

// Built-in self test: 1 pass, 2 fail.
uint8_t sonar_self_test(uint8_t sensor);
