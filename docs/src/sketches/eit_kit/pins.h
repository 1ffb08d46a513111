// The one place to change: which pin of the microcontroller goes where, and what the analogue parts are.
#pragma once
#include <stdint.h>

// Four multiplexers of 16 ways (ADG1606, CD74HC4067) or 32 ways (ADG731, by SPI). Each connects one electrode to
// one line: the current's source and sink, the voltmeter's plus and minus.
enum Line : uint8_t { SOURCE, SINK, PLUS, MINUS, LINES };

#define MUX_IS_ADG731 0                 // 1: four ADG731 on the SPI bus; 0: four parts with parallel addresses

const uint8_t ELECTRODES = 16;          // of the skin: at most 16 with parallel addresses, 32 with ADG731

// Parallel addresses A0 to A3 and the enable pin of each multiplexer, by line.
const uint8_t MUX_ADDRESS[LINES][4] = {
  {2, 3, 4, 5},                         // source
  {6, 7, 8, 9},                         // sink
  {24, 25, 26, 27},                     // plus
  {28, 29, 30, 31},                     // minus
};
const uint8_t MUX_ENABLE[LINES] = {32, 33, 34, 35};
const uint8_t MUX_ON = 1;               // level at which a multiplexer conducts (ADG1606: high; CD74HC4067: low)
// ADG731: one SYNC pin for each line in place of the above.
const uint8_t MUX_SYNC[LINES] = {32, 33, 34, 35};

// Source: an AD5930 by SPI, whose sine goes through a Howland pump; 0: the DAC pin makes the sine.
#define SOURCE_IS_AD5930 1
const uint8_t AD5930_FSYNC = 10;
const uint8_t AD5930_CTRL = 37;
const uint8_t AD5930_STANDBY = 38;
const double AD5930_CLOCK_HZ = 50e6;

const uint8_t ADC_PIN = 14;             // output of the instrumentation amplifier, about half the reference
const uint8_t ADC_BITS = 12;
const float ADC_REFERENCE_V = 3.3f;
const float AMPLIFIER_GAIN = 10.0f;     // from electrodes to ADC
const float CURRENT_A = 350e-6f;        // amplitude of the pump at the electrodes

const float DRIVE_HZ = 10e3f;           // at the start; the host may set 1 kHz to 50 kHz
const uint16_t SETTLE_US = 150;         // from switching to the first sample
const uint8_t PERIODS = 8;              // whole periods that one reading averages
const uint8_t SAMPLES_PER_PERIOD = 8;   // at 10 kHz: one every 12.5 us
