// A button that copies a block of code, pictures that open in full size, and stills where nothing may move.
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
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) {
    for (const image of document.querySelectorAll('article img:is([src$=".gif"], [src$="-moving.webp"])')) {
      image.decode().then(() => {
        const still = Object.assign(document.createElement("canvas"), {width: image.naturalWidth, height: image.naturalHeight});
        still.getContext("2d").drawImage(image, 0, 0); // the first frame
        still.role = "img";
        still.ariaLabel = image.alt;
        image.replaceWith(still);
      });
    }
  }
});
