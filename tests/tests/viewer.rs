//! The report in a browser: the object in other light, and everything on the page that moves. Skipped, and said so, where no
//! Chromium is installed.

use std::{fs, io::BufWriter, path::Path};

use eclipse::{
    capture::Capture,
    image_io::{ExrOptions, Precision, linear_to_srgb, write_exr_with},
    mesh_io::MeshSurface,
    reconstruction::{Reconstruction, VertexMaterial},
    relight::{Object, Quality, Stage, picture},
    report::{ReportOptions, html},
};
use eclipse_tests::{
    browser::{self, Browser, SOFTWARE},
    perfect,
    scenes::add_sphere,
};
use exr::prelude::{
    Blocks, Compression, Encoding, LineOrder, SpecificChannels, Vec2, WritableImage,
};
use glam::{Mat4, Vec3};
use image::{Rgb, RgbImage, codecs::hdr::HdrEncoder};
use render::{
    bsdf::Model, camera::Camera, environment::EnvironmentMap, image::Image, lat_long::LatLong,
    mesh::Mesh,
};

/// The compressions of OpenEXR that the viewer reads.
const COMPRESSIONS: [Compression; 4] = [
    Compression::Uncompressed,
    Compression::RLE,
    Compression::ZIP1,
    Compression::ZIP16,
];
/// Pixels across and down a block that is compared.
const BLOCK: usize = 8;
/// Most by which blocks may differ, root mean square, of 255 levels.
const TOLERANCE: f64 = 1.5;
/// Counts draws and collects what WebGL complains about.
const WATCH: &str = "window.drawn = 0; window.glErrors = [];
    for (const name of ['drawElements', 'drawArrays', 'texImage2D', 'texImage3D', 'bufferData']) {
        const own = WebGL2RenderingContext.prototype[name];
        WebGL2RenderingContext.prototype[name] = function (...values) {
            own.apply(this, values);
            const error = this.getError();
            if (error) window.glErrors.push(`${name}: ${error}`);
            if (name === 'drawElements') window.drawn++;
        };
    }";
const MESSAGE: &str = "document.getElementById('viewer-message').textContent";

/// Writes the page of a reconstruction.
fn page(folder: &Path, capture: &Capture, solved: &Reconstruction) -> std::path::PathBuf {
    let path = folder.join("report.html");
    let text = html(capture, solved, &ReportOptions::new("eclipse")).unwrap();
    fs::write(&path, text).unwrap();
    path
}

/// Writes a Radiance map of 64 × 32 whose texels are `colour` of their direction.
fn radiance_map(path: &Path, colour: impl Fn(Vec3) -> [f32; 3]) -> Image {
    let grid = LatLong::new(32, 64);
    let texels: Vec<[f32; 3]> = (0..grid.len())
        .map(|k| colour(grid.texel_direction(k / 64, k % 64)))
        .collect();
    let file = BufWriter::new(fs::File::create(path).unwrap());
    let pixels: Vec<Rgb<f32>> = texels.iter().map(|&texel| Rgb(texel)).collect();
    HdrEncoder::new(file).encode(&pixels, 64, 32).unwrap();
    Image {
        width: 64,
        height: 32,
        channels: 3,
        data: texels.concat(),
    }
}

/// Puts lines into the header of a Radiance map.
fn exposed(path: &Path, lines: &str) {
    let bytes = fs::read(path).unwrap();
    let first = bytes.iter().position(|&byte| byte == b'\n').unwrap() + 1;
    fs::write(
        path,
        [&bytes[..first], lines.as_bytes(), &bytes[first..]].concat(),
    )
    .unwrap();
}

/// Writes an OpenEXR map of 64 × 32 by the `exr` crate.
fn purple(path: &Path, compression: Compression, texel: impl Fn(usize, usize) -> [f32; 3] + Sync) {
    let encoding = Encoding {
        compression,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let channels = SpecificChannels::rgb(|at: Vec2<usize>| {
        let [r, g, b] = texel(at.x(), at.y());
        (r, g, b)
    });
    exr::image::Image::from_encoded_channels((64, 32), encoding, channels)
        .write()
        .to_file(path)
        .unwrap();
}

/// The share of pixels that differ visibly.
fn changed(a: &RgbImage, b: &RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let differ = |(p, q): (&Rgb<u8>, &Rgb<u8>)| (0..3).any(|c| p[c].abs_diff(q[c]) > 3);
    let count = a.pixels().zip(b.pixels()).filter(|&pair| differ(pair));
    count.count() as f64 / f64::from(a.width() * a.height())
}

fn mean(image: &RgbImage, channel: usize) -> f64 {
    let sum: f64 = image.pixels().map(|pixel| f64::from(pixel[channel])).sum();
    sum / f64::from(image.width() * image.height())
}

/// The page with its viewer under the recovered light.
fn opened(program: &Path, page: &Path, window: [u32; 2]) -> Browser {
    let mut browser = Browser::start(program, &SOFTWARE, window);
    browser.before_each_page(WATCH);
    browser.open(page);
    browser.place("viewer-canvas");
    browser.wait_for(&format!("{MESSAGE} === 'Under the recovered light.'"));
    browser
}

#[test]
fn the_object_turns_and_its_light_is_exposed_turned_chosen_and_dropped() {
    let Some(program) = browser::installed() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let capture = perfect::capture();
    let mut solved = perfect::reconstruction(&capture);
    solved.settings.lambertian = false;
    let page = page(folder.path(), &capture, &solved);
    let mut browser = opened(&program, &page, [1000, 900]);

    let first = browser.picture("viewer-canvas");
    if let Some(keep) = std::env::var_os("ECLIPSE_KEEP_PICTURES") {
        first.save(Path::new(&keep).join("viewer.png")).unwrap();
    }
    browser.drag("viewer-canvas", [0.4, 0.5], [0.6, 0.45]);
    let turned = browser.picture("viewer-canvas");
    assert!(changed(&first, &turned) > 0.2);

    browser.click("viewer-exposure", [0.7, 0.5]);
    let brighter = browser.picture("viewer-canvas");
    assert!(mean(&brighter, 1) > 1.2 * mean(&turned, 1));
    let stops = browser.evaluate("document.getElementById('viewer-stops').textContent");
    assert!(stops.as_str().unwrap().starts_with('+'), "{stops}");
    browser.click("viewer-exposure", [0.5, 0.5]);
    assert!(changed(&turned, &browser.picture("viewer-canvas")) < 0.01);

    browser.click("viewer-rotation", [0.8, 0.5]);
    assert!(changed(&turned, &browser.picture("viewer-canvas")) > 0.2);
    browser.click("viewer-rotation", [0.5, 0.5]);
    browser.click("viewer-backdrop", [0.5, 0.5]);
    let alone = browser.picture("viewer-canvas");
    assert!(changed(&turned, &alone) > 0.2);

    let green = folder.path().join("green.hdr");
    radiance_map(&green, |_| [0.0, 3.0, 0.0]);
    browser.choose_file("viewer-file", &green);
    browser.wait_for(&format!("{MESSAGE} === 'Under green.hdr, 64 × 32.'"));
    let greened = browser.picture("viewer-canvas");
    let middle = greened.get_pixel(greened.width() / 2, greened.height() / 2);
    assert!(
        middle[1] > 40 && middle[0] < 5 && middle[2] < 5,
        "{middle:?}"
    );

    let red = folder.path().join("red.hdr");
    radiance_map(&red, |_| [0.2, 0.0, 0.0]);
    browser.drop_file("viewer-drop", &red);
    browser.wait_for(&format!("{MESSAGE} === 'Under red.hdr, 64 × 32.'"));
    let reddened = browser.picture("viewer-canvas");
    let middle = reddened.get_pixel(reddened.width() / 2, reddened.height() / 2);
    assert!(middle[0] > 40 && middle[1] < 5, "{middle:?}");

    // The same light, multiplied as the header says.
    let brighter = folder.path().join("brighter.hdr");
    radiance_map(&brighter, |_| [0.8, 0.0, 0.0]);
    browser.choose_file("viewer-file", &green);
    browser.wait_for(&format!("{MESSAGE} === 'Under green.hdr, 64 × 32.'"));
    exposed(&brighter, "EXPOSURE=2\nCOLORCORR=2 1 1\n");
    browser.drop_file("viewer-drop", &brighter);
    browser.wait_for(&format!("{MESSAGE} === 'Under brighter.hdr, 64 × 32.'"));
    assert!(changed(&reddened, &browser.picture("viewer-canvas")) < 0.001);

    // OpenEXR as other programs write it, in each compression that is read.
    for (k, compression) in COMPRESSIONS.into_iter().enumerate() {
        let name = format!("purple{k}.exr");
        let path = folder.path().join(&name);
        let texel = [0.3f32, 0.0, 0.3];
        // Uneven, so that there is something to compress.
        purple(&path, compression, |x, y| {
            texel.map(|v| v * (1.0 + 0.01 * ((x + y) % 7) as f32))
        });
        browser.drop_file("viewer-drop", &path);
        browser.wait_for(&format!("{MESSAGE} === 'Under {name}, 64 × 32.'"));
        let shown = browser.picture("viewer-canvas");
        let middle = shown.get_pixel(shown.width() / 2, shown.height() / 2);
        assert!(
            middle[0] > 40 && middle[1] < 5 && middle[2] > 40,
            "{compression:?}: {middle:?}"
        );
        browser.drop_file("viewer-drop", &red);
        browser.wait_for(&format!("{MESSAGE} === 'Under red.hdr, 64 × 32.'"));
    }

    // OpenEXR as eclipse writes it, of half floats and of full ones, with an opacity that says nothing of light.
    let blue = folder.path().join("blue.exr");
    let texels = [0.0, 0.0, 0.5, 0.25].repeat(64 * 32);
    let light = Image {
        width: 64,
        height: 32,
        channels: 4,
        data: texels,
    };
    let mut deep = Vec::new();
    for precision in [Precision::Half, Precision::Float] {
        browser.click("viewer-recovered", [0.5, 0.5]);
        browser.wait_for(&format!("{MESSAGE} === 'Under the recovered light.'"));
        let options = ExrOptions {
            precision,
            ..ExrOptions::default()
        };
        write_exr_with(&blue, &light, &["R", "G", "B", "A"], &options).unwrap();
        deep = fs::read(&blue).unwrap();
        browser.choose_file("viewer-file", &blue);
        browser.wait_for(&format!("{MESSAGE} === 'Under blue.exr, 64 × 32.'"));
        let shown = browser.picture("viewer-canvas");
        let middle = shown.get_pixel(shown.width() / 2, shown.height() / 2);
        assert!(middle[2] > 40 && middle[0] < 5, "{middle:?}");
    }
    browser.drop_file("viewer-drop", &red);
    browser.wait_for(&format!("{MESSAGE} === 'Under red.hdr, 64 × 32.'"));
    let mut damaged = deep.clone();
    let last = damaged.len() - 40;
    damaged[last..].fill(0x55);
    let mut tiled = deep.clone();
    tiled[5] |= 2;

    // What cannot be read is said, and changes nothing.
    let whole = fs::read(&red).unwrap();
    exposed(&brighter, "EXPOSURE=0\n");
    let dark = fs::read(&brighter).unwrap();
    for (name, bytes, word) in [
        ("dark.hdr", &dark[..], "EXPOSURE=0"),
        ("short.hdr", &whole[..whole.len() / 2], "cannot be used"),
        ("short.exr", &deep[..deep.len() / 2], "cannot be used"),
        ("other.exr", &damaged, "damaged"),
        ("tiled.exr", &tiled, "tiles"),
        ("empty.exr", &b"\x76\x2f\x31\x01"[..], "neither"),
    ] {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        browser.drop_file("viewer-drop", &path);
        browser.wait_for(&format!(
            "{MESSAGE}.startsWith('{name}') && {MESSAGE}.includes('{word}')"
        ));
        assert!(changed(&reddened, &browser.picture("viewer-canvas")) < 0.001);
    }

    assert!(browser.evaluate("window.drawn").as_u64().unwrap() > 8);
    assert_eq!(browser.evaluate("window.glErrors.join()"), "");
    assert_eq!(browser.exceptions, Vec::<String>::new());
}

/// A ball of one material in place of the bundled capture's object.
fn ball(material: VertexMaterial, lambertian: bool) -> (Capture, Reconstruction) {
    let mut mesh = Mesh::default();
    add_sphere(&mut mesh, Vec3::ZERO, 1.0, 64);
    let mut capture = perfect::capture();
    let mut solved = perfect::reconstruction(&capture);
    solved.vertex_materials = vec![material; mesh.positions.len()];
    solved.settings.lambertian = lambertian;
    capture.mesh = mesh;
    (capture, solved)
}

#[test]
fn a_ball_looks_as_the_renderer_sees_it() {
    let Some(program) = browser::installed() else {
        return;
    };
    // A room with a bright window, brighter above; smooth enough for the map that the viewer gathers from.
    let room = |d: Vec3| {
        let window = (-12.0 * (1.0 - d.dot(Vec3::new(0.6, -0.5, 0.62).normalize()))).exp();
        [0.4, 0.3, 0.2].map(|floor| floor * (1.2 + d.z) + 6.0 * window)
    };
    for (alpha, kappa, lambertian) in [(1.0, 0.0, true), (0.36, 0.04, false), (0.09, 0.2, false)] {
        let material = VertexMaterial {
            albedo: [0.6, 0.4, 0.2],
            alpha,
            kappa,
        };
        let (capture, solved) = ball(material, lambertian);
        let folder = tempfile::tempdir().unwrap();
        let page = page(folder.path(), &capture, &solved);
        // A small canvas: the reference takes paths for each of its pixels.
        let mut browser = opened(&program, &page, [420, 700]);
        let map = folder.path().join("room.hdr");
        let light = radiance_map(&map, room);
        browser.choose_file("viewer-file", &map);
        browser.wait_for(&format!("{MESSAGE}.startsWith('Under room.hdr')"));
        browser.click("viewer-backdrop", [0.5, 0.5]);
        let seen = browser.picture("viewer-canvas");

        // The same camera, light and exposure, by paths.
        let object: serde_json::Value = browser.evaluate(
            "(({azimuth, elevation, exposure, radius}) => [azimuth, elevation, exposure, radius])(data.object)",
        );
        let [azimuth, elevation, exposure, radius] =
            std::array::from_fn(|k| object[k].as_f64().unwrap() as f32);
        let toward = Vec3::new(
            azimuth.cos() * elevation.cos(),
            azimuth.sin() * elevation.cos(),
            elevation.sin(),
        );
        let (width, height) = (seen.width() as usize, seen.height() as usize);
        let aspect = width as f32 / height as f32;
        let across = 2.0 * (15f32.to_radians().tan() * aspect).atan();
        let camera = Camera::look_at(width, height, across, 4.2 * radius * toward, Vec3::ZERO);
        assert_ne!(camera.world_from_camera, Mat4::IDENTITY);
        let model = if lambertian {
            Model::Lambertian
        } else {
            Model::Microfacet
        };
        let surface = MeshSurface::Vertices(vec![material; capture.mesh.positions.len()]);
        let object = Object::new(capture.mesh.clone(), surface, model);
        let factor = exposure * mean_radiance(&solved.environment) / mean_radiance(&light);
        let environment = EnvironmentMap::new(light).unwrap();
        let stage = Stage::new(object, environment, factor.log2()).unwrap();
        let quality = Quality {
            samples: 256,
            seed: 1,
            backdrop: false,
        };
        let expected = picture(&stage, &camera, 0, &quality, &|_| true).unwrap();

        // Means over blocks that lie wholly on the ball: the paths' noise averages out, at the outline the two antialias differently.
        let (mut sum, mut count, mut worst) = (0.0, 0, 0f64);
        for (top, left) in (0..height / BLOCK)
            .flat_map(|y| (0..width / BLOCK).map(move |x| (y * BLOCK, x * BLOCK)))
        {
            let pixels = || (0..BLOCK * BLOCK).map(|k| (left + k % BLOCK, top + k / BLOCK));
            if pixels().any(|(x, y)| expected.pixel(x, y)[3] < 0.999) {
                continue;
            }
            for c in 0..3 {
                let difference = |(x, y): (usize, usize)| {
                    let value = expected.pixel(x, y)[c].clamp(0.0, 1.0);
                    let shown = 255.0 * f64::from(linear_to_srgb(value));
                    shown - f64::from(seen.get_pixel(x as u32, y as u32)[c])
                };
                let mean = pixels().map(difference).sum::<f64>() / (BLOCK * BLOCK) as f64;
                sum += mean * mean;
                worst = worst.max(mean.abs());
                count += 1;
            }
        }
        assert!(count > 900, "{count} values on the ball");
        let rms = (sum / f64::from(count)).sqrt();
        println!("alpha {alpha}, kappa {kappa}: {rms:.2} of 255, at most {worst:.1}");
        assert!(rms < TOLERANCE, "alpha {alpha}: {rms} of 255");
        assert_eq!(browser.evaluate("window.glErrors.join()"), "");
        assert_eq!(browser.exceptions, Vec::<String>::new());
    }
}

/// The mean over all directions and channels.
fn mean_radiance(image: &Image) -> f32 {
    let grid = LatLong::new(image.height, image.width);
    let rows = image.data.chunks_exact(3 * image.width).enumerate();
    let sum: f32 = rows
        .map(|(row, texels)| grid.solid_angle(row) * texels.iter().sum::<f32>() / 3.0)
        .sum();
    sum / (4.0 * std::f32::consts::PI)
}

#[test]
fn without_webgl_a_message_stands_in_its_place_and_the_rest_works() {
    let Some(program) = browser::installed() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let capture = perfect::capture();
    let solved = perfect::reconstruction(&capture);
    let page = page(folder.path(), &capture, &solved);
    let mut browser = Browser::start(&program, &["--disable-3d-apis"], [1000, 900]);
    browser.open(&page);
    browser.place("viewer");
    browser.wait_for(&format!("{MESSAGE}.includes('needs WebGL 2')"));
    assert_eq!(
        browser.evaluate("document.getElementById('viewer-canvas').offsetHeight"),
        0
    );

    // Frames, the edge between photograph and render, and the radiance under the pointer.
    let source = "document.getElementById('frame-photograph').src.length + document.getElementById('frame-name').textContent";
    let before = browser.evaluate(source);
    browser.click("frame", [0.9, 0.5]);
    assert_ne!(before, browser.evaluate(source));
    let clip = "document.getElementById('frame-photograph').style.clipPath";
    browser.click("edge", [0.8, 0.5]);
    let edge = browser.evaluate(clip);
    let share: f64 = edge
        .as_str()
        .and_then(|text| text.split([' ', '%']).nth(1)?.parse().ok())
        .unwrap();
    assert!((15.0..25.0).contains(&share), "{edge}");
    browser.hover("environment", [0.75, 0.25]);
    let texel = browser.evaluate("document.getElementById('texel').textContent");
    let texel = texel.as_str().unwrap();
    // Three quarters across is −y, a quarter down halfway to the zenith.
    let (row, column) = (12, 75);
    let radiance = solved.environment.pixel(column, row)[0];
    assert!(
        texel.starts_with("Azimuth -92° from +x, elevation 45°: "),
        "{texel}"
    );
    let red: f32 = texel
        .split(": ")
        .nth(1)
        .and_then(|text| text.split(',').next()?.parse().ok())
        .unwrap();
    assert!(
        (red - radiance).abs() <= 0.006 * radiance,
        "{texel}, {radiance}"
    );
    assert_eq!(browser.exceptions, Vec::<String>::new());
}
