// Replaces the picture on the first page with the skin, if it was built into the book.
document.getElementById("poke-start")?.addEventListener("click", async () => {
  const note = document.getElementById("poke-note");
  const isThere = await fetch("poke/index.html", { method: "HEAD" }).then((answer) => answer.ok, () => false);
  if (!isThere) {
    note.innerHTML = "This copy of the book was built without the skin, or is not read from a server. " +
      "<code>scripts/wasm-demo</code> in the repository makes it; then build the book again and <code>mdbook serve docs</code>.";
    return;
  }
  const frame = document.createElement("iframe");
  frame.src = "poke/index.html?embed";
  frame.title = "The liquid disc, to press with mouse, fingers or keys";
  document.getElementById("poke-start").replaceWith(frame);
  note.innerHTML = 'Press with the mouse or with fingers; the wheel changes the pressure. ' +
    '<a href="poke/index.html">All of the page</a> has channels, noise and times as well.';
});
