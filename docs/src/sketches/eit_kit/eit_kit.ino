// An EIT kit on the wire of dermis: four multiplexers, a sine source with a current pump, an instrumentation amplifier,
// and a Teensy 4 or ESP32. The host sets the skin's channels, current and frequency; the pins are in pins.h.
//
// Each reading is the sine's amplitude in phase with the drive: samples at fixed phases of whole periods, times the
// drive's cosine and sine, so that offsets and mains hum drop out.
#include <SPI.h>
#include <math.h>
#include "pins.h"
#include "wire.h"

const uint16_t MOST_CHANNELS = 1024;
const float PI_F = 3.14159265f;

struct Channel { uint8_t source, sink, plus, minus; };
Channel channels[MOST_CHANNELS];
float volts[MOST_CHANNELS];
uint16_t channelCount = 0;
uint16_t comingCount = 0;              // channels of a list that is arriving in parts
float driveHz = DRIVE_HZ;
float askedRate = 0.0f;                // frames per second; 0: as many as possible
uint32_t sequence = 0;
uint32_t bootNumber = 0;
bool flowing = false;
uint32_t lastFrameUs = 0;
bool saturated = false;

wire::Receiver<320> receiver;

void writeSerial(const uint8_t* bytes, size_t count) { Serial.write(bytes, count); }

// -- The analogue parts ----------------------------------------------------------------------------------------------

void connect(uint8_t line, uint8_t electrode) {
#if MUX_IS_ADG731
  digitalWrite(MUX_SYNC[line], LOW);
  SPI.transfer(electrode < 32 ? electrode : 0x80);   // bit 7 opens all switches
  digitalWrite(MUX_SYNC[line], HIGH);
#else
  digitalWrite(MUX_ENABLE[line], !MUX_ON);           // breaks before it makes
  if (electrode >= ELECTRODES) return;
  for (uint8_t bit = 0; bit < 4; bit++) digitalWrite(MUX_ADDRESS[line][bit], electrode >> bit & 1);
  digitalWrite(MUX_ENABLE[line], MUX_ON);
#endif
}

void setDrive(float hertz) {
  driveHz = hertz;
#if SOURCE_IS_AD5930
  const uint32_t word = (uint32_t)(hertz * 16777216.0 / AD5930_CLOCK_HZ + 0.5);
  const uint16_t words[] = {
    0x0E83,                                          // control: 24-bit frequency, output on, sine, continuous
    (uint16_t)(0xC000 | (word & 0x0FFF)),            // low half of the start frequency
    (uint16_t)(0xD000 | (word >> 12 & 0x0FFF)),      // high half
  };
  for (uint16_t value : words) {
    digitalWrite(AD5930_FSYNC, LOW);
    SPI.transfer16(value);
    digitalWrite(AD5930_FSYNC, HIGH);
  }
  digitalWrite(AD5930_CTRL, HIGH);                   // a rising edge starts the sine
  delayMicroseconds(10);
  digitalWrite(AD5930_CTRL, LOW);
#endif
}

// Amplitude of the voltage between plus and minus, volts, in phase with the current.
float measure(const Channel& channel) {
  connect(SOURCE, channel.source);
  connect(SINK, channel.sink);
  connect(PLUS, channel.plus);
  connect(MINUS, channel.minus);
  delayMicroseconds(SETTLE_US);
  const uint16_t count = PERIODS * SAMPLES_PER_PERIOD;
  const float stepUs = 1e6f / (driveHz * SAMPLES_PER_PERIOD);
  const uint16_t top = (1u << ADC_BITS) - 1;
  float cosine = 0.0f, sine = 0.0f;
  const uint32_t begin = micros();
  for (uint16_t k = 0; k < count; k++) {
    while (micros() - begin < (uint32_t)(k * stepUs)) {}
    const uint16_t raw = (uint16_t)analogRead(ADC_PIN);
    saturated = saturated || raw == 0 || raw == top;
    const float phase = 2.0f * PI_F * (k % SAMPLES_PER_PERIOD) / SAMPLES_PER_PERIOD;
    cosine += raw * cosf(phase);
    sine += raw * sinf(phase);
  }
  const float amplitude = 2.0f / count * sqrtf(cosine * cosine + sine * sine);
  return amplitude * ADC_REFERENCE_V / (top * AMPLIFIER_GAIN);
}

// -- The wire --------------------------------------------------------------------------------------------------------

void describe(uint32_t nonce) {
  wire::Sender out(writeSerial, wire::DESCRIBE);
  out.number<uint32_t>(nonce);
  out.number<uint32_t>(bootNumber);
  out.number<uint16_t>(ELECTRODES);
  out.number<uint16_t>(channelCount);
  out.put((uint8_t)2);                               // f32
  out.put(ADC_BITS);
  out.put((uint8_t)((flowing ? 1 : 0) | 4));         // readings are magnitudes
  out.put((uint8_t)0);
  out.number<uint32_t>(1u << wire::PROTOCOL | 1u << wire::FREQUENCY | 1u << wire::RATE | 1u << wire::START |
                       1u << wire::STOP | 1u << wire::SHOT);
  const float readingS = 1e-6f * SETTLE_US + PERIODS / driveHz;
  const float most = channelCount > 0 ? 1.0f / (channelCount * readingS) : 0.0f;
  out.number<float>(askedRate > 0.0f && askedRate < most ? askedRate : most);
  out.number<float>(most);
  out.number<float>(CURRENT_A);
  out.number<float>(driveHz);
  out.text("EIT kit");
  out.text("");
  out.text("1.0");
  out.text("listed");
  out.text("");
  out.finish();
}

void reply(uint16_t tag, uint8_t code, uint8_t status, const float* number) {
  wire::Sender out(writeSerial, wire::REPLY);
  out.number<uint16_t>(tag);
  out.put(code);
  out.put(status);
  out.number<uint16_t>(number ? 1 : 0);
  if (number) out.number<float>(*number);
  out.finish();
}

void sendFrame(bool isShot) {
  saturated = false;
  const uint64_t timeNs = (uint64_t)micros() * 1000u;
  for (uint16_t k = 0; k < channelCount; k++) {
    volts[k] = measure(channels[k]);
  }
  wire::Sender out(writeSerial, wire::FRAME);
  out.number<uint32_t>(sequence++);
  out.number<uint64_t>(timeNs);
  out.number<uint16_t>((saturated ? 1 : 0) | (isShot ? 8 : 0));
  out.number<uint16_t>(channelCount);
  out.put((uint8_t)2);
  out.put((uint8_t)0);
  out.put((uint8_t)0);
  out.put((uint8_t)0);
  out.number<float>(1.0f);
  for (uint16_t k = 0; k < channelCount; k++) out.number<float>(volts[k]);
  out.finish();
}

// A part of the list of channels.
uint8_t takeProtocol(const uint8_t* bytes, size_t size) {
  if (size < 6) return wire::BAD;
  const uint16_t first = wire::read<uint16_t>(bytes), total = wire::read<uint16_t>(bytes + 2);
  const uint16_t count = wire::read<uint16_t>(bytes + 4);
  if (size != 6u + 4u * count || first + count > total || total > MOST_CHANNELS) return wire::BAD;
  if (first != 0 && first != comingCount) return wire::BAD;
  for (uint16_t k = 0; k < count; k++) {
    const uint8_t* four = bytes + 6 + 4 * k;
    // The current needs both of its electrodes; a voltage may be against the reference, which the minus line floats to.
    if (four[0] >= ELECTRODES || four[1] >= ELECTRODES || four[2] >= ELECTRODES) return wire::BAD;
    if (four[3] >= ELECTRODES) return wire::BAD;
    channels[first + k] = {four[0], four[1], four[2], four[3]};
  }
  comingCount = first + count;
  if (comingCount == total) channelCount = total;
  return wire::DONE;
}

void obey(const uint8_t* bytes, size_t size) {
  if (size < 4) return;
  const uint16_t tag = wire::read<uint16_t>(bytes);
  const uint8_t code = bytes[2];
  const uint8_t* arguments = bytes + 4;
  const size_t left = size - 4;
  uint8_t status = wire::DONE;
  const float* number = 0;
  float value = left == 4 ? wire::read<float>(arguments) : 0.0f;
  switch (code) {
    case wire::PROTOCOL:
      status = flowing ? (uint8_t)wire::BUSY : takeProtocol(arguments, left);
      break;
    case wire::FREQUENCY:
      if (left != 4 || !(value >= 1e3f && value <= 50e3f)) { status = wire::BAD; break; }
      setDrive(value);
      number = &driveHz;
      break;
    case wire::RATE:
      if (left != 4 || !(value > 0.0f)) { status = wire::BAD; break; }
      askedRate = value;
      number = &askedRate;
      break;
    case wire::START:
      if (channelCount == 0) { status = wire::FAILED; break; }
      flowing = true;
      break;
    case wire::STOP:
      flowing = false;
      break;
    case wire::SHOT:
      if (flowing) status = wire::BUSY; else if (channelCount == 0) status = wire::FAILED;
      break;
    default:
      status = wire::UNKNOWN;
  }
  reply(tag, code, status, number);
  if (code == wire::SHOT && status == wire::DONE) sendFrame(true);
}

void listen() {
  while (Serial.available() > 0) {
    if (!receiver.take((uint8_t)Serial.read())) continue;
    if (receiver.kind() == wire::HELLO && receiver.size() == 6) {
      const uint8_t* hello = receiver.payload();
      if (hello[4] <= 1 && hello[5] >= 1) describe(wire::read<uint32_t>(hello));
    } else if (receiver.kind() == wire::COMMAND) {
      obey(receiver.payload(), receiver.size());
    }
  }
}

void setup() {
  Serial.begin(921600);
  SPI.begin();
  for (uint8_t line = 0; line < LINES; line++) {
#if MUX_IS_ADG731
    pinMode(MUX_SYNC[line], OUTPUT);
    digitalWrite(MUX_SYNC[line], HIGH);
#else
    pinMode(MUX_ENABLE[line], OUTPUT);
    for (uint8_t bit = 0; bit < 4; bit++) pinMode(MUX_ADDRESS[line][bit], OUTPUT);
#endif
    connect(line, 255);
  }
#if SOURCE_IS_AD5930
  pinMode(AD5930_FSYNC, OUTPUT);
  pinMode(AD5930_CTRL, OUTPUT);
  pinMode(AD5930_STANDBY, OUTPUT);
  digitalWrite(AD5930_STANDBY, LOW);
#endif
  analogReadResolution(ADC_BITS);
  setDrive(DRIVE_HZ);
  // Adjacent drive and measurement until the host sends the skin's own list.
  for (uint8_t a = 0; a < ELECTRODES; a++) {
    for (uint8_t j = 0; j < ELECTRODES; j++) {
      const uint8_t b = (a + 1) % ELECTRODES, next = (j + 1) % ELECTRODES;
      if (j == a || j == b || next == a || next == b) continue;
      channels[channelCount++] = {b, a, j, next};
    }
  }
  bootNumber = micros() * 2654435761u + (uint32_t)analogRead(ADC_PIN);
  describe(0);
}

void loop() {
  listen();
  if (!flowing) return;
  const uint32_t now = micros();
  if (askedRate > 0.0f && now - lastFrameUs < (uint32_t)(1e6f / askedRate)) return;
  lastFrameUs = now;
  sendFrame(false);
}
