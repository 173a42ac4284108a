// Pins and numbers of your rig. Everything else of the sketch is the same for all.
#pragma once

#include <cstdint>

namespace config {

constexpr char kFirmware[] = "saranga-rig 1.0";

// ---- sensors (SPI bus and pins of SonicLib's board file are set there as well: docs/firmware.md) ----
constexpr uint8_t kSensors = 2;                       // 1 to 3
constexpr uint8_t kRoles[3] = {0, 1, 2};              // 0 left, 1 right, 2 down, by SonicLib's device number
constexpr uint8_t kTransmitter = 0;                   // device number of the one that transmits
constexpr uint16_t kTransmitCycles = 640;             // length of the burst in ASIC cycles, as TDK's examples have it
constexpr uint8_t kTransmitWidth = 3, kTransmitPhase = 8;

// ---- thrust stand ----
constexpr bool kHasStand = true;
constexpr uint8_t kHx711Data = 33, kHx711Clock = 34;
constexpr int32_t kZeroCounts = 0;                    // counts without load
constexpr float kCountsPerNewton = 0.0f;              // 0: not calibrated, thrust reads NaN (docs/firmware.md)

// ---- ESC ----
constexpr bool kHasThrottle = true;
constexpr uint8_t kEscPin = 5;                        // PWM, 400 Hz
constexpr float kEscLowUs = 1000.0f, kEscHighUs = 2000.0f;
constexpr unsigned kMotorPoles = 14;                  // magnets of the bell
constexpr uint32_t kTelemetryGapMs = 500;             // older telemetry reads NaN

}  // namespace config
