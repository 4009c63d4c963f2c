// Example firmware for the controller side of protocol version 2 (docs/protocol.md):
// two thermoelectric cells on a dual H-bridge, a thermistor beside each, one line of data ten times
// a second. It trips by itself on heat, on a broken thermistor and on silence, and stays off then
// until somebody resets it.
//
// Written for an Arduino Uno or Mega, wired as docs/firmware/wiring.md says. Change the rig's name,
// the cells, the pins and the trip; nothing else depends on the rig. The camera sends on a link of
// its own (docs/firmware/lepton.md).

#include <EEPROM.h>
#ifdef __AVR__
#include <avr/wdt.h>
#endif

#ifndef RELAY
#define RELAY ""                              // the name in [limits] of the rig file: "power%20off"
#endif

const char RIG[] = "dual-cell";
const char CELL_NAMES[] = "P1,P2";
const int CELLS = 2;
const int COUNTS = 255;                       // of full duty
const int PWM_PIN[CELLS] = {9, 10};           // with timer 1: 490 Hz, or 4 kHz by its prescaler
const int HEAT_PIN[CELLS] = {7, 5};           // direction inputs of the bridge
const int COOL_PIN[CELLS] = {8, 6};
const int RELAY_PIN = 4;                      // high: the supply is on; nothing without a RELAY
const int THERMISTOR_PIN[CELLS] = {A0, A1};   // 10 kohm, B = 3950 K, to ground; 10 kohm to 5 V
const int HOT = 80;                           // readings below: above 93 degC, or a short circuit
const int BROKEN = 1000;                      // readings above: below -35 degC, or no thermistor
const int HOT_READINGS = 5;                   // in a row: one alone is noise
const unsigned long WATCHDOG_MS = 2000;       // no command for so long: off
const unsigned long PERIOD_MS = 100;

int applied[CELLS];
char owner[33] = "";                          // who commands, or did last
const char *trip = "";                        // why it is off until a reset
unsigned long boot, sequence, eventSequence, number, lastCommand, lastData;
bool owned = false, supplied = true;          // whether the owner commands still

// ---------------------------------------------------------------------------- lines, going out

char line[200];
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
  put("hello version=2 rig="), put(RIG);
  put(" boot="), putNumber(boot);
  put(" cells="), put(CELL_NAMES);
  put(" counts="), putNumber(COUNTS);
  put(" watchdog="), putNumber(WATCHDOG_MS / 1000);
  if (*RELAY) put(" relay="), put(RELAY);
  send();
}

void sendData() {
  put("data seq="), putNumber(sequence++);
  put(" t="), putNumber(now());
  putCounts(" pwm=", applied);
  if (owned) put(" owner="), put(owner), put(" n="), putNumber(number);
  if (*trip) put(" trip="), put(trip);
  if (*RELAY) put(" relay="), put(supplied ? "on" : "off");
  send();
}

void sendEvent(const char *kind, const char *why, const char *who = "", unsigned long about = 0) {
  put("event seq="), putNumber(eventSequence++);
  put(" t="), putNumber(now());
  put(" kind="), put(kind);
  if (*who) put(" owner="), put(who), put(" n="), putNumber(about);
  if (*why) put(" why="), put(why);
  send();
}

// -------------------------------------------------------------------------------------- bridge

void apply(const int *counts) {
  for (int i = 0; i < CELLS; i++) {
    if ((counts[i] > 0) != (applied[i] > 0) || (counts[i] < 0) != (applied[i] < 0)) {
      analogWrite(PWM_PIN[i], 0);  // no direction changes under current
    }
    applied[i] = counts[i];
    digitalWrite(HEAT_PIN[i], counts[i] > 0);
    digitalWrite(COOL_PIN[i], counts[i] < 0);
    analogWrite(PWM_PIN[i], abs(counts[i]));
  }
}

void switchOff() {  // and lets another command
  const int off[CELLS] = {0};
  apply(off);
  owned = false;
}

void supply(bool on) {  // by the relay: off also where the bridge no longer obeys
  supplied = on || !*RELAY;
  if (*RELAY) digitalWrite(RELAY_PIN, on);
}

void tripNow(const char *why) {
  supply(false);
  switchOff();
  if (*trip) return;  // the first reason says what to look for
  trip = why;
  sendEvent("trip", why);
}

// ------------------------------------------------------------------------------ lines, coming in

const int MOST_FIELDS = 4;
char *keys[MOST_FIELDS], *values[MOST_FIELDS];
int fields;

bool split(char *text) {  // "word key=value key=value", in any order, each once
  fields = 0;
  while ((text = strchr(text, ' '))) {
    *text++ = '\0';
    if (fields == MOST_FIELDS) return false;
    keys[fields] = text;
    char *equals = strchr(text, '=');
    char *blank = strchr(text, ' ');
    if (!equals || (blank && equals > blank)) return false;
    *equals = '\0';
    values[fields] = equals + 1;
    for (int i = 0; i < fields; i++) {
      if (strcmp(keys[i], keys[fields]) == 0) return false;
    }
    fields++;
    text = equals + 1;
  }
  return true;
}

const char *field(const char *key) {
  for (int i = 0; i < fields; i++) {
    if (strcmp(keys[i], key) == 0) return values[i];
  }
  return "";
}

// A whole number at the start of a text: digits, without zeros before it, and a minus where one is
// allowed. Returns what follows, or NULL.
const char *readNumber(const char *text, bool isSigned, int *sign, uint32_t *magnitude) {
  *sign = 1;
  if (*text == '-' && isSigned) *sign = -1, text++;
  if (*text == '0' && (*sign < 0 || (text[1] >= '0' && text[1] <= '9'))) return NULL;
  uint64_t number = 0;
  int digits = 0;
  while (*text >= '0' && *text <= '9' && digits++ < 10) number = 10 * number + (*text++ - '0');
  if (digits == 0 || digits > 10 || number > 0xFFFFFFFF) return NULL;
  *magnitude = (uint32_t)number;
  return text;
}

// 1: counts for all cells. 0: numbers, but not these cells or beyond full duty. -1: no numbers.
int readCounts(const char *text, int *counts) {
  int sign;
  uint32_t magnitude;
  bool possible = true;
  for (int i = 0;; i++) {
    text = readNumber(text, true, &sign, &magnitude);
    if (!text) return -1;
    if (i >= CELLS || magnitude > (uint32_t)COUNTS) possible = false;
    else counts[i] = sign * (int)magnitude;
    if (*text == '\0') return possible && i + 1 == CELLS;
    if (*text++ != ',') return -1;
  }
}

bool isWord(const char *text) {
  int count = 0;
  for (; *text; text++, count++) {
    bool allowed = (*text >= '0' && *text <= '9') || (*text >= 'A' && *text <= 'Z') ||
                   (*text >= 'a' && *text <= 'z') || *text == '_' || *text == '.' || *text == '-';
    if (!allowed) return false;
  }
  return count >= 1 && count <= 32;
}

void command(const char *word, const char *who, unsigned long about) {
  if (strcmp(word, "stop") == 0) {  // anyone may stop
    tripNow("stop");
    return;
  }
  if (strcmp(word, "relay") == 0) {  // anyone, too
    if (*RELAY && strcmp(field("name"), RELAY) == 0) tripNow("relay");
    else sendEvent("refused", "relay", who, about);
    return;
  }
  if (strcmp(word, "reset") == 0 && *trip) {
    trip = "";
    supply(true);
    sendEvent("reset", "", who, about);
    return;
  }
  if (owned && strcmp(owner, who) != 0) {
    sendEvent("refused", "owner", who, about);
    return;
  }
  if (strcmp(word, "release") == 0) switchOff();
}

void duty(const char *who, unsigned long about, const int *counts) {
  const char *why = "";
  if (owned && strcmp(owner, who) != 0) why = "owner";
  else if (*trip) why = "tripped";
  else if (!counts) why = "range";  // not cut to what is possible
  else if (strcmp(owner, who) == 0 && (int32_t)((uint32_t)about - (uint32_t)number) <= 0) why = "old";
  if (*why) {
    sendEvent("refused", why, who, about);
    return;
  }
  strcpy(owner, who);
  number = about, owned = true, lastCommand = millis();  // only this feeds the watchdog
  apply(counts);
}

void obey(char *text, int count) {
  char checksum[9] = {0};
  if (count < 10 || text[count - 9] != '*') return;
  putChecksum(checksum, crc32(text, count - 9));
  if (strncmp(text + count - 8, checksum, 8) != 0) return;  // a damaged command is no command
  text[count - 9] = '\0';
  if (strlen(text) != (size_t)(count - 9)) return;
  bool whole = split(text);
  if (strcmp(text, "hello") == 0) {
    if (*field("rig")) return;  // a device that speaks
    if (strcmp(field("version"), "2") != 0 || (whole && fields == 1)) sendHello();
    return;
  }
  int sign;
  uint32_t about;
  const char *end = readNumber(field("n"), false, &sign, &about);
  if (!whole || !end || *end || !isWord(field("owner"))) return;
  if (strcmp(text, "duty") == 0 && fields == 3) {
    int counts[CELLS];
    int possible = readCounts(field("pwm"), counts);
    if (possible >= 0) duty(field("owner"), about, possible ? counts : NULL);
  } else if (fields == 2 && (strcmp(text, "stop") == 0 || strcmp(text, "reset") == 0 ||
                             strcmp(text, "release") == 0)) {
    command(text, field("owner"), about);
  } else if (fields == 3 && strcmp(text, "relay") == 0 && *field("name")) {
    command(text, field("owner"), about);
  }
}

void listen() {
  static char text[160];
  static int count;
  for (int most = 64; most > 0 && Serial.available(); most--) {  // a flood must not delay the trips
    char c = Serial.read();
    if (c == '\n') {
      if (count > 0 && count < (int)sizeof(text) && text[count - 1] == '\r') count--;
      if (count < (int)sizeof(text)) {
        text[count] = '\0';
        obey(text, count);
      }  // a longer line was none of ours
      count = 0;
    } else if (count < (int)sizeof(text)) {
      text[count++] = c;
    }
  }
}

// ---------------------------------------------------------------------------------------- trips

bool isOn() {
  for (int i = 0; i < CELLS; i++) {
    if (applied[i]) return true;
  }
  return false;
}

void checkThermistors() {
  static int suspicious;
  const char *why = "";
  for (int i = 0; i < CELLS; i++) {
    int reading = analogRead(THERMISTOR_PIN[i]);
    if (reading < HOT) why = "over-temperature";
    else if (reading > BROKEN && !*why) why = "thermistor";
  }
  suspicious = *why ? suspicious + 1 : 0;
  if (suspicious >= HOT_READINGS && isOn()) tripNow(why);
}

void checkWatchdog() {
  if (!owned || millis() - lastCommand <= WATCHDOG_MS) return;
  if (isOn()) tripNow("watchdog");
  else switchOff();
}

// ----------------------------------------------------------------------------------------- main

void setup() {
  for (int i = 0; i < CELLS; i++) {  // off before they are outputs: no pulse at the start
    digitalWrite(PWM_PIN[i], LOW), digitalWrite(HEAT_PIN[i], LOW), digitalWrite(COOL_PIN[i], LOW);
    pinMode(PWM_PIN[i], OUTPUT), pinMode(HEAT_PIN[i], OUTPUT), pinMode(COOL_PIN[i], OUTPUT);
  }
  if (*RELAY) digitalWrite(RELAY_PIN, LOW), pinMode(RELAY_PIN, OUTPUT);
  supply(true);
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
  checkThermistors();
  checkWatchdog();
  if (millis() - lastData >= PERIOD_MS) {
    lastData += PERIOD_MS;
    sendData();
  }
}
