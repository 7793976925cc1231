//! Python with the packages that read our files, and the viewer that comes with one of them.
#![allow(dead_code, unreachable_pub, reason = "each test file uses its part")]
#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

/// Rerun of the same version as the crate that writes the files, with data frames; the readers of MCAP files and of JSON
/// Schema.
const PACKAGES: [&str; 3] = ["rerun-sdk[catalog]==0.36.3", "mcap==1.6.0", "jsonschema==4.25.1"];

/// Runs a command that must succeed.
pub fn succeed(command: &mut Command) -> Output {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let said = [&output.stdout[..], &output.stderr].concat();
    assert!(output.status.success(), "{command:?}: {}\n{}", output.status, String::from_utf8_lossy(&said));
    output
}

/// The environment with the packages in it, installed when it is not there yet.
pub fn environment() -> PathBuf {
    environment_with("python-venv", &PACKAGES)
}

/// An environment of its own with these packages.
pub fn environment_with(name: &str, packages: &[&str]) -> PathBuf {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
    let home = target.join(name);
    // Other tests may do the same now: whoever holds the lock installs, the others find it installed.
    let lock = fs::File::create(target.join(format!("{name}.lock"))).unwrap();
    lock.lock().unwrap();
    // Names what is installed, and is only there when the installation came to its end.
    let installed = home.join("installed");
    if fs::read_to_string(&installed).is_ok_and(|what| what == packages.join(" ")) {
        return home;
    }
    succeed(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&home));
    let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
    succeed(Command::new(home.join("bin/python")).args(pip).args(packages));
    fs::write(installed, packages.join(" ")).unwrap();
    home
}

/// The viewer itself; the `rerun` on the path of the environment is a script around it.
pub fn viewer(environment: &Path) -> PathBuf {
    let lib = fs::read_dir(environment.join("lib")).unwrap().flatten();
    let binary = |python: fs::DirEntry| python.path().join("site-packages/rerun_sdk/rerun_cli/rerun");
    lib.map(binary).find(|path| path.exists()).expect("the viewer is installed")
}

/// What a program says in this environment, in a folder, with arguments.
pub fn say(folder: &Path, program: &str, arguments: &[&str]) -> String {
    say_in(&environment(), folder, program, arguments)
}

/// The same in another environment.
pub fn say_in(environment: &Path, folder: &Path, program: &str, arguments: &[&str]) -> String {
    let mut python = Command::new(environment.join("bin/python"));
    let output = succeed(python.current_dir(folder).args(["-c", program]).args(arguments));
    String::from_utf8(output.stdout).unwrap()
}

/// Prints how many devices Vulkan knows.
const DEVICES: &str = r"
import ctypes
try:
    vulkan = ctypes.CDLL('libvulkan.so.1')
except OSError:
    raise SystemExit(print(0))
# A VkInstanceCreateInfo: its type is one, everything else in its 64 bytes is nothing.
create, instance, count = (ctypes.c_uint32 * 16)(1), ctypes.c_void_p(), ctypes.c_uint32()
if vulkan.vkCreateInstance(create, None, ctypes.byref(instance)) == 0:
    vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
print(count.value)
";

/// Whether the viewer can draw pictures here; says so on the terminal when it can't.
pub static CAN_DRAW: LazyLock<bool> = LazyLock::new(|| {
    let can = say(Path::new("/"), DEVICES, &[]).trim() != "0";
    if !can {
        let text = "pictures are not checked: there is no Vulkan driver (Debian: mesa-vulkan-drivers, libvulkan1)";
        #[expect(clippy::explicit_write, reason = "the harness would keep what a test that passes prints")]
        writeln!(std::io::stderr(), "{text}").unwrap();
    }
    can
});
