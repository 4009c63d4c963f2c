// Runs the sketch for as many milliseconds as its argument says.
#include "Arduino.h"
uint32_t turns = 0;
SerialPort Serial;
#include SKETCH
int main(int, char **arguments) {
  setup();
  for (long left = atol(arguments[1]); left > 0; left--) {
    turns++;
    loop();
  }
  fflush(stdout);
}
