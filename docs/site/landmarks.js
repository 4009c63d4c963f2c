// The bars of buttons that the theme adds to blocks of code are landmarks, each of which needs a name.

function named() {
  document.querySelectorAll(".md-code__nav:not([aria-label])").forEach((bar) => {
    const bars = [...document.querySelectorAll(".md-code__nav")];
    bar.setAttribute("aria-label", `Code ${bars.indexOf(bar) + 1}`);
  });
}

new MutationObserver(named).observe(document.documentElement, { childList: true, subtree: true });
