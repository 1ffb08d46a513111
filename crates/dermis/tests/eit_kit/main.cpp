// The EIT kit's sketch on a computer: prints the port that it listens on, and ends with the connection. The converter
// sees a sine whose amplitude says which electrodes the multiplexers connect.
#include <arpa/inet.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>
#include "Arduino.h"
#include "SPI.h"

SerialPort Serial;
SpiBus SPI;
static int connection;
static uint8_t level[256];
static uint32_t clockUs;

#include "eit_kit.ino"

void pinMode(uint8_t, uint8_t) {}
void digitalWrite(uint8_t pin, uint8_t now) { level[pin] = now; }
void analogReadResolution(uint8_t) {}
void delayMicroseconds(unsigned us) { clockUs += us; }
uint32_t micros() { return clockUs++; }

static int electrode(uint8_t line) {
  if (level[MUX_ENABLE[line]] != MUX_ON) return -1;
  int number = 0;
  for (int bit = 0; bit < 4; bit++) number |= level[MUX_ADDRESS[line][bit]] << bit;
  return number;
}

int analogRead(uint8_t) {
  const int source = electrode(SOURCE), sink = electrode(SINK), plus = electrode(PLUS), minus = electrode(MINUS);
  const double amplitude = 100.0 + 40.0 * source + 20.0 * sink + 10.0 * plus + 5.0 * minus;
  const double phase = 2.0 * M_PI * driveHz * clockUs * 1e-6 + 0.3;
  return (int)lround(2048.0 + amplitude * sin(phase));
}

int SerialPort::available() {
  int waiting = 0;
  if (ioctl(connection, FIONREAD, &waiting) < 0) exit(0);
  if (waiting == 0) {
    uint8_t byte;
    if (recv(connection, &byte, 1, MSG_PEEK | MSG_DONTWAIT) == 0) exit(0);
  }
  return waiting;
}
int SerialPort::read() {
  uint8_t byte;
  if (recv(connection, &byte, 1, 0) != 1) exit(0);
  return byte;
}
size_t SerialPort::write(const uint8_t* bytes, size_t count) {
  for (size_t sent = 0; sent < count;) {
    const ssize_t now = send(connection, bytes + sent, count - sent, MSG_NOSIGNAL);
    if (now <= 0) exit(0);
    sent += now;
  }
  return count;
}

int main() {
  const int listener = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof(address);
  if (bind(listener, (sockaddr*)&address, size) || listen(listener, 1)) return 1;
  getsockname(listener, (sockaddr*)&address, &size);
  printf("%d\n", ntohs(address.sin_port));
  fflush(stdout);
  connection = accept(listener, 0, 0);
  setup();
  for (;;) {
    loop();
    if (!flowing) usleep(500);
  }
}
