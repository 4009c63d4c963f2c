// What the theme adds to a page: the bars of buttons of blocks of code are landmarks, each of which
// needs a name, and a table that scrolls must be reached by the keyboard.

function named() {
  document.querySelectorAll(".md-code__nav").forEach((bar, k) => bar.setAttribute("aria-label", `Code ${k + 1}`));
  document.querySelectorAll(".md-typeset__scrollwrap").forEach((table) => { table.tabIndex = 0; });
}

new MutationObserver(named).observe(document.documentElement, { childList: true, subtree: true });
