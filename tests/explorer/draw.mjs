// Clears the editor of a widget and draws a road of three tiles in it, on a map of 5 x 6.
export const drawRoad = async (page, widget) => {
  await widget.getByRole("tab", { name: "Draw" }).click();
  await widget.getByRole("button", { name: "Clear" }).click();
  await widget.locator(".editor").scrollIntoViewIfNeeded();
  const box = await widget.locator(".editor").boundingBox();
  const at = (row, column) => [box.x + ((column + 0.5) * box.width) / 6, box.y + ((row + 0.5) * box.height) / 5];
  await page.mouse.move(...at(1, 1));
  await page.mouse.down();
  await page.mouse.move(...at(1, 3), { steps: 4 });
  await page.mouse.up();
};
