// Runs the sketch: milliseconds, then since when the thermistors are hot, since when broken (or -1).
// With a fourth argument it runs in steps of so many milliseconds: before each it takes a block of
// input, after it it gives a block of output, each with its length in four bytes before it.
#include "Arduino.h"
uint32_t turns = 0;
int pins[20], modes[20];
long hotFrom = -1, brokenFrom = -1;
Input input;
Output output;
SerialPort Serial;
#include SKETCH

static bool takeBlock() {
  uint32_t length;
  if (fread(&length, 4, 1, stdin) != 1) return false;
  for (; length > 0; length--) input.put(fgetc(stdin));
  return true;
}

static void giveBlock() {
  uint32_t length = output.size();
  fwrite(&length, 4, 1, stdout);
  output.flush();
}

int main(int count, char **arguments) {
  hotFrom = atol(arguments[2]);
  brokenFrom = atol(arguments[3]);
  long step = count > 4 ? atol(arguments[4]) : 0;
  if (!step) {
    int next;
    while ((next = fgetc(stdin)) != EOF) input.put(next);
  }
  for (int pin = 0; pin < 20; pin++) pins[pin] = -1;  // whatever was there
  setup();
  for (long left = atol(arguments[1]); left > 0; left--) {
    if (step && turns % step == 0 && !takeBlock()) break;
    turns++;
    loop();
    if (step && turns % step == 0) giveBlock();
  }
  output.flush();
}
