#pragma once
#include <stdint.h>
struct SpiBus {
  void begin() {}
  uint8_t transfer(uint8_t) { return 0; }
  uint16_t transfer16(uint16_t) { return 0; }
};
extern SpiBus SPI;
