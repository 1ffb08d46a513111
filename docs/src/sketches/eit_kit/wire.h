// The wire of dermis, version 1, for a microcontroller: packets with CRC-32 and COBS stuffing, sent and received byte by
// byte. Nothing here knows pins; numbers are little-endian, as on every board that this sketch is for.
#pragma once
#include <stdint.h>
#include <string.h>

namespace wire {

enum Kind : uint8_t { DESCRIBE = 0x01, REPLY = 0x02, FRAME = 0x03, HELLO = 0x11, COMMAND = 0x12 };
enum Code : uint8_t { PROTOCOL = 0, AMPLITUDE = 2, FREQUENCY = 3, RATE = 5, START = 6, STOP = 7, SHOT = 8 };
enum Status : uint8_t { DONE = 0, UNKNOWN = 1, BAD = 2, BUSY = 3, FAILED = 4 };

inline uint32_t crc32(uint32_t crc, uint8_t byte) {
  crc ^= byte;
  for (uint8_t bit = 0; bit < 8; bit++) {
    crc = crc & 1 ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
  }
  return crc;
}

// Sends one packet through a function, stuffing it on the way: 254 bytes of memory.
class Sender {
 public:
  typedef void (*Write)(const uint8_t* bytes, size_t count);

  Sender(Write write, uint8_t kind) : write_(write), crc_(0xFFFFFFFFu), length_(0) {
    const uint8_t zero = 0;
    write_(&zero, 1);
    put((uint8_t)1);
    put(kind);
  }

  void put(uint8_t byte) {
    crc_ = crc32(crc_, byte);
    stuff(byte);
  }
  template <typename T> void number(T value) {
    uint8_t bytes[sizeof(T)];
    memcpy(bytes, &value, sizeof(T));
    for (size_t k = 0; k < sizeof(T); k++) put(bytes[k]);
  }
  void text(const char* words) {
    const size_t length = strlen(words);
    put((uint8_t)length);
    for (size_t k = 0; k < length; k++) put((uint8_t)words[k]);
  }
  void finish() {
    const uint32_t crc = crc_ ^ 0xFFFFFFFFu;
    for (uint8_t k = 0; k < 4; k++) stuff((uint8_t)(crc >> 8 * k));
    flush();
    const uint8_t zero = 0;
    write_(&zero, 1);
  }

 private:
  void stuff(uint8_t byte) {
    if (length_ == 254) flush();
    if (byte == 0) {
      flush();
    } else {
      piece_[length_++] = byte;
    }
  }
  // Sends a piece after its code: its length plus 1, or 255 if no zero follows.
  void flush() {
    const uint8_t code = (uint8_t)(length_ + 1);
    write_(&code, 1);
    if (length_ > 0) write_(piece_, length_);
    length_ = 0;
  }

  Write write_;
  uint32_t crc_;
  uint8_t piece_[254];
  uint8_t length_;
};

// Collects bytes up to a zero and unstuffs them; longer packets than its memory are skipped.
template <size_t MOST> class Receiver {
 public:
  Receiver() : length_(0), too_long_(false) {}

  // True if the byte completed an undamaged packet, which kind(), payload() and size() then describe.
  bool take(uint8_t byte) {
    if (byte != 0) {
      if (length_ < MOST) bytes_[length_++] = byte; else too_long_ = true;
      return false;
    }
    const bool whole = !too_long_ && length_ > 0 && unstuff() && check();
    length_ = 0;
    too_long_ = false;
    return whole;
  }
  uint8_t kind() const { return bytes_[1]; }
  const uint8_t* payload() const { return bytes_ + 2; }
  size_t size() const { return size_; }

 private:
  bool unstuff() {
    size_t from = 0, to = 0;
    while (from < length_) {
      const uint8_t code = bytes_[from++];
      if (from + code - 1 > length_) return false;
      for (uint8_t k = 1; k < code; k++) bytes_[to++] = bytes_[from++];
      if (code != 255 && from < length_) bytes_[to++] = 0;
    }
    whole_ = to;
    return true;
  }
  bool check() {
    if (whole_ < 6 || bytes_[0] != 1) return false;
    uint32_t crc = 0xFFFFFFFFu, sent = 0;
    for (size_t k = 0; k + 4 < whole_; k++) crc = crc32(crc, bytes_[k]);
    for (uint8_t k = 0; k < 4; k++) sent |= (uint32_t)bytes_[whole_ - 4 + k] << 8 * k;
    size_ = whole_ - 6;
    return (crc ^ 0xFFFFFFFFu) == sent;
  }

  uint8_t bytes_[MOST];
  size_t length_, whole_, size_;
  bool too_long_;
};

template <typename T> T read(const uint8_t* bytes) {
  T value;
  memcpy(&value, bytes, sizeof(T));
  return value;
}

}  // namespace wire
