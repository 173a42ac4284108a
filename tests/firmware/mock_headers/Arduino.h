// Declarations only, of what the sketch uses of Teensyduino: for a syntax and type check without it.
#pragma once
#include <cmath>
#include <cstddef>
#include <cstdint>
constexpr uint8_t HIGH = 1, LOW = 0, INPUT = 0, OUTPUT = 1;
uint32_t micros();
uint32_t millis();
void delayMicroseconds(uint32_t us);
void pinMode(uint8_t pin, uint8_t mode);
uint8_t digitalReadFast(uint8_t pin);
void digitalWriteFast(uint8_t pin, uint8_t value);
void analogWrite(int pin, int value);
uint32_t analogWriteResolution(uint32_t bits);
void analogWriteFrequency(uint8_t pin, float frequency);
void noInterrupts();
void interrupts();
struct SerialPort {
  void begin(long baud);
  int available();
  int read();
  size_t write(const uint8_t* data, size_t size);
};
extern SerialPort Serial, Serial1;
struct IntervalTimer {
  bool begin(void (*function)(), float microseconds);
};
