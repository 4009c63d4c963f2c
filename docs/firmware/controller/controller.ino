// Example firmware for the controller side of protocol version 1 (docs/protocol.md):
// two thermoelectric cells on a dual H-bridge, one line of data ten times a second, a watchdog.
//
// Written for an Arduino Uno or Mega. Change the rig's name, the cells and the pins; nothing else
// depends on the rig. The camera sends on a link of its own (docs/firmware/lepton.md).

#include <EEPROM.h>
#ifdef __AVR__
#include <avr/wdt.h>
#endif

const char RIG[] = "dual-cell";
const char CELL_NAMES[] = "P1,P2";
const int CELLS = 2;
const int COUNTS = 255;                       // of full duty
const int PWM_PIN[CELLS] = {9, 10};           // with timer 1: 490 Hz, or 4 kHz by its prescaler
const int HEAT_PIN[CELLS] = {7, 5};           // direction inputs of the bridge
const int COOL_PIN[CELLS] = {8, 6};
const unsigned long WATCHDOG_MS = 2000;       // no command for so long: off
const unsigned long PERIOD_MS = 100;

int applied[CELLS];
unsigned long boot, sequence, eventSequence, lastCommand, lastData;

// ---------------------------------------------------------------------------- lines, going out

char line[128];
int length;

void put(char c) {
  if (length < (int)sizeof(line)) line[length++] = c;
}

void put(const char *text) {
  while (*text) put(*text++);
}

void putNumber(uint64_t number) {
  char digits[20];
  int count = 0;
  do digits[count++] = '0' + number % 10;
  while (number /= 10);
  while (count) put(digits[--count]);
}

void putCounts(const char *key, const int *counts) {
  put(key);
  for (int i = 0; i < CELLS; i++) {
    if (i) put(',');
    if (counts[i] < 0) put('-');
    putNumber(abs(counts[i]));
  }
}

uint32_t crc32(const char *text, int count) {  // that of zlib, four bits at a time
  static const uint32_t TABLE[16] = {
      0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C,
      0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C};
  uint32_t crc = 0xFFFFFFFF;
  for (int i = 0; i < count; i++) {
    crc ^= (uint8_t)text[i];
    crc = TABLE[crc & 15] ^ (crc >> 4);
    crc = TABLE[crc & 15] ^ (crc >> 4);
  }
  return ~crc;
}

void putChecksum(char *to, uint32_t crc) {  // eight hexadecimal digits, upper case
  for (int i = 7; i >= 0; i--, crc >>= 4) to[i] = "0123456789ABCDEF"[crc & 15];
}

void send() {
  char checksum[9] = {0};
  putChecksum(checksum, crc32(line, length));
  Serial.write(line, length);
  Serial.write('*');
  Serial.write(checksum, 8);
  Serial.write('\n');
  length = 0;
}

// ------------------------------------------------------------------------------------ messages

uint64_t now() {  // microseconds since the start; micros() alone begins anew after 71 minutes
  static uint32_t last, high;
  uint32_t low = micros();
  if (low < last) high++;
  last = low;
  return ((uint64_t)high << 32) | low;
}

void sendHello() {
  put("hello version=1 rig="), put(RIG);
  put(" boot="), putNumber(boot);
  put(" cells="), put(CELL_NAMES);
  put(" counts="), putNumber(COUNTS);
  put(" watchdog="), putNumber(WATCHDOG_MS / 1000);
  send();
}

void sendData() {
  put("data seq="), putNumber(sequence++);
  put(" t="), putNumber(now());
  putCounts(" pwm=", applied);
  send();
}

void sendEvent(const char *kind) {
  put("event seq="), putNumber(eventSequence++);
  put(" t="), putNumber(now());
  put(" kind="), put(kind);
  send();
}

// -------------------------------------------------------------------------------------- bridge

void apply(const int *counts) {
  for (int i = 0; i < CELLS; i++) {
    applied[i] = constrain(counts[i], -COUNTS, COUNTS);
    digitalWrite(HEAT_PIN[i], applied[i] > 0);
    digitalWrite(COOL_PIN[i], applied[i] < 0);
    analogWrite(PWM_PIN[i], abs(applied[i]));
  }
}

void switchOff() {
  const int off[CELLS] = {0};
  apply(off);
}

// ------------------------------------------------------------------------------ lines, coming in

bool parseCounts(const char *text, int *counts) {  // exactly CELLS whole numbers
  for (int i = 0; i < CELLS; i++) {
    char *end;
    long number = strtol(text, &end, 10);
    if (end == text || *end != (i + 1 < CELLS ? ',' : '\0')) return false;
    counts[i] = (int)constrain(number, (long)-COUNTS, (long)COUNTS);
    text = end + 1;
  }
  return true;
}

void obey(char *text, int count) {
  char checksum[9] = {0};
  if (count < 10 || text[count - 9] != '*') return;
  putChecksum(checksum, crc32(text, count - 9));
  if (strncmp(text + count - 8, checksum, 8) != 0) return;  // a damaged command is no command
  text[count - 9] = '\0';
  if (strncmp(text, "hello ", 6) == 0) {
    sendHello();
    return;
  }
  int counts[CELLS];
  const char *pwm = strstr(text, " pwm=");
  if (strncmp(text, "duty n=", 7) == 0 && pwm && parseCounts(pwm + 5, counts)) {
    apply(counts);
    lastCommand = millis();
  }
}

void listen() {
  static char text[96];
  static int count;
  while (Serial.available()) {
    char c = Serial.read();
    if (c == '\n') {
      if (count < (int)sizeof(text)) obey(text, count);  // a longer line was none of ours
      count = 0;
    } else if (count < (int)sizeof(text)) {
      text[count++] = c;
    }
  }
}

// ----------------------------------------------------------------------------------------- main

void setup() {
  for (int i = 0; i < CELLS; i++) {
    pinMode(PWM_PIN[i], OUTPUT), pinMode(HEAT_PIN[i], OUTPUT), pinMode(COOL_PIN[i], OUTPUT);
  }
  switchOff();
  // A number that no earlier start had: hosts must see that the counters begin anew.
  EEPROM.get(0, boot);
  EEPROM.put(0, ++boot);
  Serial.begin(115200);
  sendHello();
#ifdef __AVR__
  wdt_enable(WDTO_1S);  // firmware that hangs is restarted, which switches the cells off
#endif
}

void loop() {
#ifdef __AVR__
  wdt_reset();
#endif
  listen();
  bool on = false;
  for (int i = 0; i < CELLS; i++) on = on || applied[i];
  if (on && millis() - lastCommand > WATCHDOG_MS) {
    switchOff();
    sendEvent("watchdog");
  }
  if (millis() - lastData >= PERIOD_MS) {
    lastData += PERIOD_MS;
    sendData();
  }
}
