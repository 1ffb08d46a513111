// The parts of the Arduino library that the EIT kit's sketch needs, for a computer: pins that remember their level, a
// clock that advances by a microsecond at every reading, and a serial port that is a socket.
#pragma once
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum { LOW = 0, HIGH = 1, INPUT = 0, OUTPUT = 1 };
void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t level);
int analogRead(uint8_t pin);
void analogReadResolution(uint8_t bits);
void delayMicroseconds(unsigned us);
uint32_t micros();

struct SerialPort {
  void begin(unsigned long) {}
  int available();
  int read();
  size_t write(const uint8_t* bytes, size_t count);
};
extern SerialPort Serial;
