// What goes wrong in the page is written on its root element: it says so to whoever looks, tests included.
{
  const note = (text) => {
    const root = document.documentElement;
    root.dataset.errors = (root.dataset.errors || "") + text + "; ";
  };
  addEventListener("error", (event) => note(event.message || "a part did not load"));
  addEventListener("unhandledrejection", (event) => note(String(event.reason)));
  addEventListener("securitypolicyviolation", (event) => note(`refused ${event.violatedDirective} ${event.blockedURI}`));
}
