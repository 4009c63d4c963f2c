// As much of Arduino as the example sketch needs, on standard input and output.
// Time advances by 1 ms in each turn of the loop, so a run is the same on every machine.
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#define OUTPUT 1
#define constrain(x, low, high) ((x) < (low) ? (low) : (x) > (high) ? (high) : (x))

extern uint32_t turns;
inline unsigned long millis() { return turns; }
inline uint32_t micros() { return turns * 1000u; }
inline void pinMode(int, int) {}
inline void digitalWrite(int, int) {}
inline void analogWrite(int, int) {}

struct SerialPort {
  void begin(long) {}
  int available() {  // at its end the line is silent
    int next = fgetc(stdin);
    if (next != EOF) ungetc(next, stdin);
    return next != EOF;
  }
  int read() { return fgetc(stdin); }
  void write(char c) { fputc(c, stdout); }
  void write(const char *text, int count) { fwrite(text, 1, count, stdout); }
};
extern SerialPort Serial;
