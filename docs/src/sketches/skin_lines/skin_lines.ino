// Eight electrodes of a conductive sheet on pins A0 to A7 of an Arduino Mega, each through a resistor of 1 kOhm.
// Sends one line of 40 numbers per frame, in volts: `dermis run my-skin.toml --source serial:PORT#lines:40`.
//
// One pair of neighbours drives at a time: current enters the sheet at the second electrode (5 V) and leaves at the
// first (0 V). The others are inputs, which draw no current, so their resistors do not matter. Every reading is taken in
// both directions of the current. Half of the difference has no offset, and nothing is deposited at the electrodes.

const uint8_t ELECTRODES[] = {A0, A1, A2, A3, A4, A5, A6, A7};
const uint8_t COUNT = sizeof(ELECTRODES);
const uint8_t REPEATS = 8;                        // readings averaged in each direction: more are quieter and slower
const unsigned SETTLE_US = 200;                   // until the voltages settle after a change of the current
const float VOLTS_PER_STEP = 5.0 / 1023.0;

float potential[COUNT];                           // of each electrode, in steps of the converter

void connectOnly(uint8_t low, uint8_t high) {
  for (uint8_t k = 0; k < COUNT; k++) {
    pinMode(ELECTRODES[k], INPUT);
  }
  pinMode(ELECTRODES[low], OUTPUT);
  digitalWrite(ELECTRODES[low], LOW);
  pinMode(ELECTRODES[high], OUTPUT);
  digitalWrite(ELECTRODES[high], HIGH);
  delayMicroseconds(SETTLE_US);
}

void addPotentials(uint8_t low, uint8_t high, float sign) {
  connectOnly(low, high);
  for (uint8_t k = 0; k < COUNT; k++) {
    if (k == low || k == high) {
      continue;
    }
    analogRead(ELECTRODES[k]);                    // discard the first reading after switching inputs
    for (uint8_t n = 0; n < REPEATS; n++) {
      potential[k] += sign * analogRead(ELECTRODES[k]) / (2.0 * REPEATS);
    }
  }
}

void setup() {
  Serial.begin(115200);
}

void loop() {
  for (uint8_t a = 0; a < COUNT; a++) {
    uint8_t b = (a + 1) % COUNT;
    memset(potential, 0, sizeof(potential));
    addPotentials(a, b, 1.0);                     // the current enters at b ...
    addPotentials(b, a, -1.0);                    // ... and now at a, which reverses the signs
    for (uint8_t j = 0; j < COUNT; j++) {
      uint8_t next = (j + 1) % COUNT;
      if (j == a || j == b || next == a || next == b) {
        continue;                                 // driven electrodes include their contacts: skip them
      }
      bool last = a == COUNT - 1 && j == COUNT - 3;
      Serial.print((potential[j] - potential[next]) * VOLTS_PER_STEP, 5);
      Serial.print(last ? "\r\n" : ",");
    }
  }
}
