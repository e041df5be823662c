// Takes a screenshot of the live view of a model. Started by readme_pictures.sh, in the folder of the model.
// Arguments: the program, the model, the picture to write.
const {spawn} = require("node:child_process");
const {chromium} = require("playwright-core");

const [program, model, picture_file] = process.argv.slice(2);

async function address_of(child) {
  let text = "";
  for await (const data of child.stdout) {
    text += data;
    const found = text.match(/http:\/\/\S+/);
    if (found) return found[0];
  }
  throw new Error(`b3dgs view ended: ${text}`);
}

async function main() {
  const child = spawn(program, ["view", model, "--view", "0"], {stdio: ["ignore", "pipe", "inherit"]});
  const ended = new Promise((resolve) => child.on("exit", resolve));
  const browser = await chromium.launch({executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu"]});
  try {
    const page = await browser.newPage({viewport: {width: 1000, height: 540}});
    await page.goto(await address_of(child));
    await page.waitForFunction(() => image !== null && shown_full && !wanted && !is_moving(), null, {timeout: 300000});
    await page.screenshot({path: picture_file});
  } finally {
    await browser.close();
    child.kill("SIGINT");
    await ended;
  }
}

main().catch((error) => {
  console.error(`picture_view: failed: ${error.stack}`);
  process.exit(1);
});
