/* What the theme leaves out for those who listen to pages or walk through them by keys. */
document.addEventListener("DOMContentLoaded", () => {
  for (const one of document.querySelectorAll("p.caption[role=heading]")) one.setAttribute("aria-level", "2");
  document.querySelector(".sidebar-drawer")?.setAttribute("aria-label", "Contents of the site");
  document.querySelector(".toc-drawer")?.setAttribute("aria-label", "On this page");
  if (!document.querySelector("h1")) document.querySelector("[role=main]")?.prepend(Object.assign(document.createElement("h1"), { textContent: "Search" }));
  // keys in tables break behind dots
  for (const one of document.querySelectorAll("td code .pre")) {
    const parts = one.textContent.split(/(?<=[./=,])(?=\w)/);
    one.replaceChildren(...parts.flatMap((part, k) => (k ? [document.createElement("wbr"), part] : [part])));
  }
  // code that is wider than the screen scrolls by keys
  const scrolled = () => {
    for (const one of document.querySelectorAll("pre, .cell_output, .cell_output div, .formula, .table-wrapper")) {
      if (one.scrollWidth > one.clientWidth) one.tabIndex = 0; else one.removeAttribute("tabindex");
    }
  };
  scrolled();
  window.addEventListener("resize", scrolled);
});
