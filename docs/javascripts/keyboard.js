// What is wider than the page scrolls by the keyboard, too.
document$.subscribe(() =>
  setTimeout(() => {
    for (const wide of document.querySelectorAll(".formula, .md-typeset__scrollwrap"))
      if (wide.scrollWidth > wide.clientWidth) wide.tabIndex = 0;
  })
);
