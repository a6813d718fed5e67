//! The report: whole, self-contained, and honest about what there is.

use base64::{Engine, engine::general_purpose::STANDARD};
use eclipse::report::{ReportOptions, html};
use eclipse_tests::perfect;

fn page() -> String {
    let capture = perfect::capture();
    let reconstruction = perfect::reconstruction(&capture);
    html(
        &capture,
        &reconstruction,
        &ReportOptions::new("eclipse reconstruct 'a <b>'"),
    )
    .unwrap()
}

#[test]
fn the_summary_comes_first_and_says_what_was_done_how_well() {
    let page = page();
    let summary = page
        .split("<p class=\"summary\">")
        .nth(1)
        .unwrap()
        .split("</p>")
        .next()
        .unwrap();
    assert_eq!(
        summary,
        "Light, materials and what blocked the light of each photograph were recovered from 24 photographs of \
         128 × 128 pixels in 15 s (30 iterations, up to the time limit); the renders agree with the photographs \
         to 41.2 dB, to 0 σ of the sensor's noise."
    );
}

#[test]
fn what_photographs_can_tell_at_best_stands_beside_how_sure_the_result_is() {
    let capture = perfect::capture();
    let mut solved = perfect::reconstruction(&capture);
    let limit = serde_json::json!({"texel": 22.5, "with_somebody": 0.31, "with_nobody": 0.9});
    solved.metrics.extra.insert("limit".to_owned(), limit);
    let page = html(&capture, &solved, &ReportOptions::new("eclipse")).unwrap();
    let (_, summary) = page.split_once("<p class=\"summary\">").unwrap();
    let (summary, _) = summary.split_once("</p>").unwrap();
    assert!(
        summary.ends_with(
            "Were all known but light and albedo, the best linear estimate, which assumes nothing of the light, tells 90 % of the \
             light's variance in parts of 22° with somebody behind each camera, 19 % with nobody there: it is the shadows of whoever \
             takes the photographs that tell it."
        ),
        "{summary}"
    );
    assert!(page.contains("<td>limit with nobody</td><td>0.9</td>"));

    // Where it was left out, the table says why.
    let reason = serde_json::json!({"left_out": "the run was interrupted"});
    solved.metrics.extra.insert("limit".to_owned(), reason);
    let page = html(&capture, &solved, &ReportOptions::new("eclipse")).unwrap();
    assert!(!page.contains("Were all known"));
    assert!(page.contains("<td>limit left out</td><td>the run was interrupted</td>"));
}

#[test]
fn the_viewer_says_which_of_a_runs_files_it_takes() {
    let page = page();
    assert!(page.contains("the <code>environment.hdr</code> that a run leaves beside this page"));
}

#[test]
fn reflectance_is_white_where_the_object_reflects_most_or_plastics_twice_over() {
    let capture = perfect::capture();
    let mut solved = perfect::reconstruction(&capture);
    solved.settings.lambertian = false;
    for (kappa, white) in [(0.04, "0.08"), (0.194, "0.2"), (7.0, "1")] {
        solved.vertex_materials[0].kappa = kappa;
        let page = html(&capture, &solved, &ReportOptions::new("eclipse")).unwrap();
        // Of the object in other light, and of the frames' pictures.
        let option = format!("reflectance κ, black 0 to white {white}</option>");
        assert!(page.contains(&option), "{option}");
        let caption = format!("Reflectance κ head-on, black 0 to white {white}</figcaption>");
        assert!(page.contains(&caption), "{caption}");
    }
}

#[test]
fn nothing_outside_the_page_is_needed() {
    let page = page();
    for outside in [
        "http://", "https://", "src=\"/", "url(", "@import", "<link", "fetch(",
    ] {
        assert!(!page.contains(outside), "{outside}");
    }
    let sources = page.matches(" src=\"").count();
    assert_eq!(
        sources,
        page.matches(" src=\"data:image/png;base64,").count()
    );
    // Five pictures of the first frame (Lambertian: no roughness), the environment, a strip of 24 masks.
    assert_eq!(sources, 5 + 1 + 24);
}

#[test]
fn the_scripts_data_is_json_with_the_frames_and_the_radiance() {
    let page = page();
    let data = page
        .split("id=\"data\">")
        .nth(1)
        .unwrap()
        .split("</script>")
        .next()
        .unwrap();
    let data: serde_json::Value = serde_json::from_str(data).unwrap();
    let frames = data["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 16);
    assert_eq!(
        (&frames[0]["name"], &frames[15]["name"]),
        (&"000".into(), &"023".into())
    );
    for kind in ["photograph", "render", "residual", "albedo", "occluder"] {
        assert!(frames[7]["pictures"][kind].is_string(), "{kind}");
        assert!(page.contains(&format!("id=\"frame-{kind}\"")), "{kind}");
    }
    // 50 × 100 × 3 floats.
    assert_eq!(
        data["environment"]["radiance"].as_str().unwrap().len(),
        60_000 / 3 * 4
    );
}

#[test]
fn the_object_is_packed_finely_enough() {
    let capture = perfect::capture();
    let solved = perfect::reconstruction(&capture);
    let page = html(&capture, &solved, &ReportOptions::new("eclipse")).unwrap();
    let data = page.split("id=\"data\">").nth(1).unwrap();
    let data = data.split("</script>").next().unwrap();
    let object = &serde_json::from_str::<serde_json::Value>(data).unwrap()["object"];
    let bytes = |name: &str| STANDARD.decode(object[name].as_str().unwrap()).unwrap();
    let number = |name: &str, k: usize| object[name][k].as_f64().unwrap() as f32;

    let places = bytes("places");
    assert_eq!(places.len(), 8 * capture.mesh.positions.len());
    let radius = capture.mesh.bounding_radius();
    for (position, place) in capture.mesh.positions.iter().zip(places.chunks_exact(8)) {
        for k in 0..3 {
            let share = f32::from(u16::from_le_bytes([place[2 * k], place[2 * k + 1]])) / 65535.0;
            let unpacked = number("low", k) + share * number("extent", k);
            assert!((unpacked - position[k]).abs() < 2e-5 * radius);
        }
    }
    let normals = bytes("normals");
    for (normal, packed) in capture.mesh.normals.iter().zip(normals.chunks_exact(8)) {
        for k in 0..3 {
            let unpacked =
                f32::from(i16::from_le_bytes([packed[2 * k], packed[2 * k + 1]])) / 32767.0;
            assert!((unpacked - normal[k]).abs() < 1e-4);
        }
    }
    let faces: Vec<u32> = bytes("faces")
        .chunks_exact(4)
        .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect();
    assert_eq!(faces, capture.mesh.faces.concat());
    // Albedo ½ is 188 as sRGB.
    assert_eq!(bytes("albedo")[..4], [188, 188, 188, 255]);
    assert_eq!(object["coated"], false);
}

#[test]
fn text_from_outside_is_escaped() {
    let page = page();
    assert!(page.contains("its mask &lt;ended&gt; empty"));
    assert!(page.contains("eclipse reconstruct 'a &lt;b&gt;'"));
    assert!(!page.contains("<ended>"));
}

#[test]
fn elements_are_closed() {
    let page = page();
    for element in [
        "html", "head", "body", "header", "section", "figure", "table", "svg", "script", "style",
        "div", "details", "ul", "li", "select", "option", "button", "label", "canvas", "output",
    ] {
        let opened = page.matches(&format!("<{element}>")).count()
            + page.matches(&format!("<{element} ")).count();
        assert_eq!(
            opened,
            page.matches(&format!("</{element}>")).count(),
            "{element}"
        );
    }
}

#[test]
fn what_was_not_recovered_is_left_out() {
    let capture = perfect::capture();
    let mut bare = perfect::reconstruction(&capture);
    bare.occluders.clear();
    bare.materials.clear();
    bare.vertex_materials.clear();
    bare.renders.clear();
    bare.curve.clear();
    bare.notes.clear();
    bare.noise = None;
    bare.metrics = Default::default();
    let page = html(&capture, &bare, &ReportOptions::new("eclipse")).unwrap();
    for absent in [
        "<h2>Occluders",
        "frame-render",
        "frame-albedo",
        "id=\"viewer",
        "WebGL",
        "<svg",
        "<aside",
    ] {
        assert!(!page.contains(absent), "{absent}");
    }
    assert!(page.contains("Light and materials were recovered"));
    assert!(page.contains("with an RMS residual of 0.</p>"));
}

#[test]
fn the_same_run_gives_the_same_page() {
    assert_eq!(page(), page());
}
