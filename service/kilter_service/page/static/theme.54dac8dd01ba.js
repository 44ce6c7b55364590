(()=>{var e=localStorage.getItem("kilter-theme");e&&(document.documentElement.dataset.theme=e);})();
