// As much of Arduino as the example sketch needs, on standard input and output.
// Time advances by 1 ms in each turn of the loop, so a run is the same on every machine.
// What is written to pins goes to standard error, as "ms pin value".
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <string>

#define OUTPUT 1
#define LOW 0
#define HIGH 1
#define A0 14
#define A1 15

extern uint32_t turns;
extern int pins[20], modes[20];
extern long hotFrom, brokenFrom;

inline unsigned long millis() { return turns; }
inline uint32_t micros() { return turns * 1000u; }
inline void setPin(int pin, int value) {
  if (pins[pin] == value) return;
  pins[pin] = value;
  fprintf(stderr, "%lu %d %d\n", (unsigned long)turns, pin, value);
}
inline void pinMode(int pin, int mode) {
  modes[pin] = mode;
  if (pins[pin] != 0) fprintf(stderr, "%lu %d floating\n", (unsigned long)turns, pin);
}
inline void digitalWrite(int pin, int value) { setPin(pin, value); }
inline void analogWrite(int pin, int value) { setPin(pin, value); }
inline int analogRead(int) {
  if (hotFrom >= 0 && turns >= (uint32_t)hotFrom) return 60;
  if (brokenFrom >= 0 && turns >= (uint32_t)brokenFrom) return 1023;
  return 500;
}

// What the host sent. At its end the line is silent, and so it is until the time of an "@ms\n". After
// a "~" it is noise without an end.
struct Input {
  std::deque<char> waiting;
  uint32_t silentUntil = 0;
  void put(char c) { waiting.push_back(c); }
  bool ready() {
    if (!waiting.empty() && waiting.front() == '~') return true;
    if (turns < silentUntil) return false;
    if (waiting.empty() || waiting.front() != '@') return !waiting.empty();
    std::string time;
    for (waiting.pop_front(); waiting.front() != '\n'; waiting.pop_front()) time += waiting.front();
    waiting.pop_front();
    silentUntil = atol(time.c_str());
    return ready();
  }
  int take() {
    char c = waiting.front();
    if (c != '~') waiting.pop_front();
    return (uint8_t)c;
  }
};
extern Input input;

struct Output {
  std::string waiting;
  uint32_t size() { return waiting.size(); }
  void flush() {
    fwrite(waiting.data(), 1, waiting.size(), stdout);
    fflush(stdout);
    waiting.clear();
  }
};
extern Output output;

struct SerialPort {
  void begin(long) {}
  int available() { return input.ready(); }
  int read() { return input.take(); }
  void write(char c) { output.waiting += c; }
  void write(const char *text, int count) { output.waiting.append(text, count); }
};
extern SerialPort Serial;
