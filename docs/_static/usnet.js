// A button that copies a block of code, and pictures that open in full size.
document.addEventListener("DOMContentLoaded", () => {
  for (const block of document.querySelectorAll("[class*=highlight-]:not(.highlight-output, .highlight-text, .highlight-none) > div.highlight")) {
    const button = document.createElement("button");
    button.className = "copy";
    button.textContent = "copy";
    button.onclick = async () => {
      await navigator.clipboard.writeText(block.querySelector("pre").innerText);
      button.textContent = "copied";
    };
    block.append(button);
  }
  for (const image of document.querySelectorAll("article img:not(a img)")) {
    const link = document.createElement("a");
    link.href = image.src;
    link.title = "full size";
    image.replaceWith(link);
    link.append(image);
  }
});
